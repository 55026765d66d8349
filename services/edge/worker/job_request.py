"""Validate the header of a job, and the error with which a worker refuses a call."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import grpc

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.api.header_options import box_of, options_of
from capture2vr.edge.asset.target import require_encoder, target_of
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.worker.capabilities import Capabilities
from capture2vr.order.job_options import InvalidOption, JobOptions
from capture2vr.order.option_table import GENERATE
from capture2vr.order.photo_box import PhotoBox
from capture2vr.sentences.sentence import say
from capture2vr.storage.tenant_store import DEFAULT_TENANT, valid_tenant

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}", re.ASCII)
"""Job ids, keys, collections: they become object names and log lines, so no character may mean anything to a path or a
shell."""


class RefusedError(Exception):
    """Refusal of a call with a gRPC status; `details` reads "CODE: sentence"."""

    def __init__(self, status: grpc.StatusCode, code: str, message: str) -> None:
        super().__init__(f"{code}: {message}")
        self.status = status
        self.details = f"{code}: {message}"


def invalid(code: str, message: str) -> RefusedError:
    """Refuse a call as INVALID_ARGUMENT: the caller's own mistake, which a retry does not help."""
    return RefusedError(grpc.StatusCode.INVALID_ARGUMENT, code, message)


@dataclass(frozen=True, slots=True)
class ReconstructionRequest:
    """A validated header: whose job it is, and its options, with preset and label filled in.

    options   of the job; the preset is one that is on offer, the label is the asset key where none was given
    prepared  whether the archive holds points that another worker made
    tenant    whose job it is: key and collection are the tenant's
    token     secret that Attach and Cancel must show; "": none
    capture   id of the capture, for logs and traces; "": unknown
    most_seconds  that it may compute; 0: the worker's own limit alone
    """

    job: str
    fence: int
    asset_key: str
    options: JobOptions
    prepared: bool = False
    tenant: str = DEFAULT_TENANT
    token: str = ""
    capture: str = ""
    most_seconds: float = 0.0

    @classmethod
    def of(cls, header: pb.Header, offer: Capabilities) -> ReconstructionRequest:
        """Validate a header. The first preset on offer is the default.

        Raises RefusedError: INVALID_ARGUMENT naming the field; UNAVAILABLE where only central has the preset and takes
        no jobs now.
        """
        _require_name("JOB_INVALID", "job", header.job)
        _require_name("KEY_INVALID", "asset_key", header.asset_key)
        if header.collection:
            _require_name("COLLECTION_INVALID", "collection", header.collection)
        if header.capture:
            _require_name("CAPTURE_INVALID", "capture", header.capture)
        if header.tenant and not valid_tenant(header.tenant):
            raise invalid("TENANT_INVALID", "tenant must be 1 to 32 of a-z 0-9 - and begin with a letter or digit")
        if header.target:
            _require_target(header.target, offer)
        options = _options_of(header, offer)
        _require_offered(options.preset, offer)
        return cls(
            job=header.job,
            fence=header.fence,
            asset_key=header.asset_key,
            options=options,
            prepared=header.prepared,
            tenant=header.tenant or DEFAULT_TENANT,
            token=header.token,
            capture=header.capture,
            most_seconds=header.most_seconds,
        )


def checked_box(header: pb.Header) -> PhotoBox | None:
    """Return a header's rectangle; None where it has none. Raises RefusedError INVALID_ARGUMENT."""
    try:
        return box_of(header)
    except InvalidOption as error:
        raise invalid(error.code, str(error)) from None


def _options_of(header: pb.Header, offer: Capabilities) -> JobOptions:
    try:
        options = options_of(header)
        names = replace(options.names, label=options.names.label or header.asset_key)
        return replace(options, preset=options.preset or offer.names[0], names=names).checked()
    except InvalidOption as error:
        raise invalid(error.code, str(error)) from None


def _require_name(code: str, field: str, value: str) -> None:
    if not _NAME.fullmatch(value):
        raise invalid(
            code, f"{field} must be 1 to 100 of the characters A-Z a-z 0-9 . _ - and begin with a letter or digit"
        )


def _require_target(name: str, offer: Capabilities) -> None:
    try:
        require_encoder(target_of(name), has_encoder=offer.ktx2)
    except EdgeError as error:
        raise invalid(error.code, f"{error.message}; {error.hints[0]}") from None


def _require_offered(preset: str, offer: Capabilities) -> None:
    names = ", ".join(offer.names)
    if preset in {each.name for each in offer.withheld}:
        needed = f"even its smallest fit needs more than the {offer.memory_bytes:,} bytes of this worker"
        raise invalid("MEMORY_EXCEEDED", f"preset {preset} is not offered: {needed}; use one of {names}")
    if preset in {each.name for each in offer.unavailable}:
        fault = f"preset {preset} is offered only by central at {offer.central}, which takes no jobs now"
        raise RefusedError(grpc.StatusCode.UNAVAILABLE, "CENTRAL_UNAVAILABLE", fault)
    if preset == GENERATE not in offer.names:
        raise invalid("GENERATOR_ABSENT", f"{say('generator_absent')}; {say('set_edge_generator')}")
    if preset not in offer.names:
        raise invalid("PRESET_UNKNOWN", f"there is no preset {preset}; use one of {names}")
