"""What a caller asks of the worker, checked on entry; and how the worker says no."""

from __future__ import annotations

import re
from dataclasses import dataclass

import grpc

from services.edge.api import edge_pb2 as pb
from services.edge.errors import EdgeError
from services.edge.offer import Offer
from services.edge.target import target_of

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}", re.ASCII)
"""Job ids, keys, collections: they become object names and log lines, so nothing that a path or a shell could read."""

_LINE = re.compile(r"[^\x00-\x1f\x7f-\x9f\u2028\u2029]*")
"""No control characters and no line ends; joiners stay, which emoji and Persian are written with."""

LABEL_MAX_CHARS = 200
"""A label is a caption in a headset; more would not be read."""


LEAST_M, MOST_M = 0.001, 1_000.0
"""Metres between two points of a thing that a person can have measured: a tick, a street."""


class RefusedError(Exception):
    """A call that is answered with a status: `details` reads "CODE: sentence"."""

    def __init__(self, status: grpc.StatusCode, code: str, message: str) -> None:
        super().__init__(f"{code}: {message}")
        self.status = status
        self.details = f"{code}: {message}"


def invalid(code: str, message: str) -> RefusedError:
    """The caller's own mistake: asking again will not help."""
    return RefusedError(grpc.StatusCode.INVALID_ARGUMENT, code, message)


@dataclass(frozen=True, slots=True)
class JobRequest:
    """A valid header: the fields of the wire's `Header`, with `preset` and `label` filled in.

    collection  where the asset is to be listed; "": wherever this worker lists what nobody named one for
    """

    job: str
    fence: int
    preset: str
    asset_key: str
    target: str
    isolate: bool | None
    longest_m: float | None
    label: str
    prepared: bool
    collection: str = ""

    @classmethod
    def of(cls, header: pb.Header, offer: Offer) -> JobRequest:
        """The first preset on offer is the default.

        Raises RefusedError: INVALID_ARGUMENT naming the field, UNAVAILABLE where only an absent central has the preset.
        """
        _require_name("JOB_INVALID", "job", header.job)
        _require_name("KEY_INVALID", "asset_key", header.asset_key)
        if header.collection:
            _require_name("COLLECTION_INVALID", "collection", header.collection)
        if header.target:
            _require_target(header.target, offer)
        if len(header.label) > LABEL_MAX_CHARS or not _LINE.fullmatch(header.label):
            raise invalid("LABEL_INVALID", f"label must be one line of at most {LABEL_MAX_CHARS} characters")
        preset = header.preset or offer.names[0]
        _require_offered(preset, offer)
        label = header.label or header.asset_key
        isolate = header.isolate if header.HasField("isolate") else None
        longest_m = _length("longest_m", header.longest_m) if header.longest_m else None
        return cls(
            job=header.job,
            fence=header.fence,
            preset=preset,
            asset_key=header.asset_key,
            target=header.target,
            isolate=isolate,
            longest_m=longest_m,
            label=label,
            prepared=header.prepared,
            collection=header.collection,
        )


def _require_name(code: str, field: str, value: str) -> None:
    if not _NAME.fullmatch(value):
        raise invalid(code, f"{field} must be 1 to 100 of A-Z a-z 0-9 . _ - and begin with a letter or digit")


def _require_target(name: str, offer: Offer) -> None:
    try:
        target_of(name, offer.ktx2)
    except EdgeError as error:
        raise invalid(error.code, f"{error.message}; {error.hints[0]}") from None


def _length(field: str, value: float) -> float:
    if not LEAST_M <= value <= MOST_M:  # no number is neither
        raise invalid("LENGTH_INVALID", f"{field} must be {LEAST_M} to {MOST_M} metres")
    return value


def _require_offered(preset: str, offer: Offer) -> None:
    names = ", ".join(offer.names)
    if preset in {each.name for each in offer.withheld}:
        wanted = f"even its smallest fit takes more than the {offer.memory_bytes:,} bytes of this worker"
        raise invalid("MEMORY_EXCEEDED", f"preset {preset} is not offered: {wanted}; offered are {names}")
    if preset in {each.name for each in offer.away}:
        fits = f"central at {offer.central}, which alone offers preset {preset}, takes no jobs now"
        raise RefusedError(grpc.StatusCode.UNAVAILABLE, "CENTRAL_UNAVAILABLE", fits)
    if preset not in offer.names:
        raise invalid("PRESET_UNKNOWN", f"there is no such preset; known are {names}")
