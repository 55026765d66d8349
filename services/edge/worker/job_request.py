"""Validate the header of a job, and the error with which a worker refuses a call."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar, get_args

import grpc

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.asset.target import require_encoder, target_of
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.mesh.fill_gaps import Fill
from capture2vr.edge.points.nouns import Cut
from capture2vr.edge.worker.capabilities import Capabilities
from capture2vr.order.asset_names import AssetNames
from capture2vr.order.edits import LEAST_M, MOST_M, NO_EDITS, SEE, Edits, InvalidEdits
from capture2vr.order.photo_box import HOW, InvalidBox, PhotoBox
from capture2vr.storage.catalogue.visibility import Visibility
from capture2vr.storage.tenant_store import DEFAULT_TENANT, valid_tenant

T = TypeVar("T")

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
    """A validated header: the fields of the wire's `Header`, with the defaults of `preset` and `label` filled in.

    names       of the asset; its label is the asset key where none was given
    collection  collection that lists the asset; "": this worker's default collection
    fill        which holes of the mesh are filled; None: by the kind of capture
    cut         what of the capture is kept
    box         rectangle of a single photo that the thing lies in; None: it is looked for
    edits       recipe of what to cut away, what is up and the scale
    tenant      whose job it is: key and collection are the tenant's
    token       secret that Attach and Cancel must show; "": none
    visibility  the asset's, from its first version on; None: as it is, or as its collection
    capture     id of the capture, for logs and traces; "": unknown
    """

    job: str
    fence: int
    preset: str
    asset_key: str
    target: str
    longest_m: float | None
    names: AssetNames
    prepared: bool
    collection: str = ""
    fill: Fill | None = None
    cut: Cut = "auto"
    box: PhotoBox | None = None
    edits: Edits = NO_EDITS
    tenant: str = DEFAULT_TENANT
    token: str = ""
    visibility: Visibility | None = None
    capture: str = ""

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
        names = _checked_names(header)
        preset = header.preset or offer.names[0]
        _require_offered(preset, offer)
        longest_m = _checked_length("longest_m", header.longest_m) if header.longest_m else None
        return cls(
            job=header.job,
            fence=header.fence,
            preset=preset,
            asset_key=header.asset_key,
            target=header.target,
            longest_m=longest_m,
            names=names,
            prepared=header.prepared,
            collection=header.collection,
            fill=_checked_choice("fill", header.fill, get_args(Fill)) if header.fill else None,
            cut=_checked_choice("cut", header.cut or "auto", get_args(Cut)),
            box=checked_box(header),
            edits=_checked_edits(header),
            tenant=header.tenant or DEFAULT_TENANT,
            token=header.token,
            visibility=_checked_choice("visibility", header.visibility, tuple(Visibility))
            if header.visibility
            else None,
            capture=header.capture,
        )


def checked_box(header: pb.Header) -> PhotoBox | None:
    """Return a header's rectangle; None where it has none. Raises RefusedError INVALID_ARGUMENT."""
    if not header.HasField("box"):
        return None
    try:
        return PhotoBox.of((header.box.left, header.box.top, header.box.right, header.box.bottom))
    except InvalidBox as error:
        raise invalid("BOX_INVALID", f"{error}; {HOW}") from None


def _checked_edits(header: pb.Header) -> Edits:
    """Return a header's recipe; the empty one where it has none."""
    try:
        edits = Edits.parse(header.edits) if header.edits else NO_EDITS
        edits.require_capture(header.capture)
    except InvalidEdits as error:
        raise invalid("EDITS_INVALID", f"edits: {error}; {SEE}") from None
    return edits


def _checked_choice(field: str, name: str, choices: Sequence[T]) -> T:
    """Return the one of a field's choices that has this name."""
    for choice in choices:
        if choice == name:
            return choice
    raise invalid(f"{field.upper()}_UNKNOWN", f"there is no {field} {name}; use one of {', '.join(map(str, choices))}")


def _require_name(code: str, field: str, value: str) -> None:
    if not _NAME.fullmatch(value):
        raise invalid(
            code, f"{field} must be 1 to 100 of the characters A-Z a-z 0-9 . _ - and begin with a letter or digit"
        )


def _checked_names(header: pb.Header) -> AssetNames:
    names = AssetNames(header.label or header.asset_key, header.description, tuple(header.labels))
    try:
        return names.checked()
    except ValueError as error:
        raise invalid("LABEL_INVALID", str(error)) from None


def _require_target(name: str, offer: Capabilities) -> None:
    try:
        require_encoder(target_of(name), has_encoder=offer.ktx2)
    except EdgeError as error:
        raise invalid(error.code, f"{error.message}; {error.hints[0]}") from None


def _checked_length(field: str, value: float) -> float:
    if not LEAST_M <= value <= MOST_M:  # true for NaN too
        raise invalid("LENGTH_INVALID", f"{field} must be {LEAST_M} to {MOST_M} metres")
    return value


def _require_offered(preset: str, offer: Capabilities) -> None:
    names = ", ".join(offer.names)
    if preset in {each.name for each in offer.withheld}:
        needed = f"even its smallest fit needs more than the {offer.memory_bytes:,} bytes of this worker"
        raise invalid("MEMORY_EXCEEDED", f"preset {preset} is not offered: {needed}; use one of {names}")
    if preset in {each.name for each in offer.unavailable}:
        fault = f"preset {preset} is offered only by central at {offer.central}, which takes no jobs now"
        raise RefusedError(grpc.StatusCode.UNAVAILABLE, "CENTRAL_UNAVAILABLE", fault)
    if preset not in offer.names:
        raise invalid("PRESET_UNKNOWN", f"there is no preset {preset}; use one of {names}")
