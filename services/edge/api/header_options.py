"""Options of a job on the wire: from `JobOptions` to the fields of a `Header`, and back."""

from __future__ import annotations

from typing import Any

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.order.asset_names import AssetNames
from capture2vr.order.edits import NO_EDITS, SEE, Edits, InvalidEdits
from capture2vr.order.job_options import InvalidOption, JobOptions, check_choice, check_columns
from capture2vr.order.photo_box import HOW, InvalidBox, PhotoBox


def header_fields(options: JobOptions) -> dict[str, Any]:
    """Return the fields of a `Header` that say these options."""
    return {
        "preset": options.preset,
        "target": options.target,
        "label": options.names.label,
        "description": options.names.description,
        "labels": options.names.labels,
        "columns": options.columns,
        "unit": options.unit,
        "longest_m": options.longest_m or 0.0,
        "collection": options.collection,
        "fill": options.fill,
        "box": wire_box(options.box),
        "cut": options.cut,
        "visibility": options.visibility,
        "publish_anyway": options.publish_anyway,
        "edits": "" if options.edits == NO_EDITS else options.edits.text,
    }


def options_of(header: pb.Header) -> JobOptions:
    """Return the options that a header says. Raises InvalidOption."""
    return JobOptions(
        preset=header.preset,
        target=header.target,
        cut=check_choice("cut", header.cut),
        fill=check_choice("fill", header.fill),
        columns=check_columns(header.columns),
        unit=check_choice("unit", header.unit),
        longest_m=header.longest_m or None,
        box=box_of(header),
        edits=_edits_of(header),
        names=AssetNames(header.label, header.description, tuple(header.labels)),
        collection=header.collection,
        visibility=check_choice("visibility", header.visibility),
        publish_anyway=header.publish_anyway,
    )


def wire_box(box: PhotoBox | None) -> pb.Box | None:
    """Convert a rectangle or a tap to the wire's message."""
    return (
        None if box is None else pb.Box(left=box.left, top=box.top, right=box.right, bottom=box.bottom, photo=box.photo)
    )


def box_of(header: pb.Header) -> PhotoBox | None:
    """Return a header's rectangle; None where it has none. Raises InvalidOption."""
    if not header.HasField("box"):
        return None
    try:
        return PhotoBox.of((header.box.left, header.box.top, header.box.right, header.box.bottom, header.box.photo))
    except InvalidBox as error:
        raise InvalidOption("BOX_INVALID", f"{error}; {HOW}") from None


def _edits_of(header: pb.Header) -> Edits:
    """Return a header's recipe; the empty one where it has none. Raises InvalidOption."""
    try:
        edits = Edits.parse(header.edits) if header.edits else NO_EDITS
        edits.require_capture(header.capture)
    except InvalidEdits as error:
        raise InvalidOption("EDITS_INVALID", f"edits: {error}; {SEE}") from None
    return edits
