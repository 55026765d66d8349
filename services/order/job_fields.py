"""Typed keyword arguments of Python callers: the options of a job by the names of the HTTP API, each of which may be
left out."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, TypedDict

from capture2vr.errors import BadInput
from capture2vr.order.edits import NO_EDITS, Edits, InvalidEdits
from capture2vr.order.job_options import InvalidOption, JobOptions
from capture2vr.order.option_table import CutName, FillName, VisibilityName
from capture2vr.order.photo_box import HOW, InvalidBox, PhotoBox
from capture2vr.order.reading import UnitName


class ReconstructionFields(TypedDict, total=False):
    """How a capture is reconstructed, beside the preset.

    target     device class whose budget the levels of detail must meet: "quest3", "quest2", "web", "archive"
    cut        what to keep: "object", "scene", or "auto", the object if the photos were taken around one
    fill       holes of the mesh to fill: "none", "unseen", "all"; left out: "unseen" for photos, "none" for clouds
    columns    of a table of points, by their numbers from 1, such as "x=2,y=3,z=4"
    unit       of the coordinates in a file: "m", "cm", "mm", "in", "ft", "us-ft", "deg"
    longest_m  metres between the farthest points of the object, where it was measured
    box        left, top, right, bottom of the object in a photo, or x, y on it, as shares of its sides, and behind them
               the photo's name; without one, the first photo
    edits      recipe of what to cut away, what is up and the true size, as in a manifest (docs/edits.md)
    """

    target: str
    cut: CutName
    fill: FillName
    columns: str
    unit: UnitName
    longest_m: float
    box: Sequence[float | str]
    edits: Mapping[str, Any]


class JobFields(ReconstructionFields, total=False):
    """A job of a gateway: how the capture is reconstructed, and as what it is published.

    preset       a name from `capture2vr presets`; left out: the gateway's default
    label        a name for people; left out: the asset key
    description  some lines about the asset; labels: its search words
    collection   the one that lists the asset
    visibility   who may read the asset besides its tenant
    publish_anyway  whether what its grade says to shoot again is published all the same
    """

    preset: str
    label: str
    description: str
    labels: Sequence[str]
    collection: str
    visibility: VisibilityName
    publish_anyway: bool


def options_of(fields: JobFields) -> JobOptions:
    """Convert keyword arguments to the options of a job. Raises BadInput for a value that does not fit."""
    box, edits = box_of(fields.get("box")), _edits_of(fields.get("edits"))
    try:
        return JobOptions.of({**fields, "box": box and box.as_json, "edits": edits}).checked()
    except InvalidOption as error:
        raise BadInput(str(error)) from None


def box_of(values: Sequence[float | str] | None) -> PhotoBox | None:
    """Convert left, top, right, bottom and perhaps a photo's name; None: no rectangle. Raises BadInput."""
    try:
        return None if values is None else PhotoBox.of(values)
    except InvalidBox as error:
        raise BadInput(f"box: {error} ({HOW})") from None


def _edits_of(recipe: Mapping[str, Any] | None) -> Edits:
    try:
        return NO_EDITS if recipe is None else Edits.parse(json.dumps(dict(recipe)))
    except (InvalidEdits, TypeError) as error:
        raise BadInput(f"edits: {error} (docs/edits.md describes a recipe)") from None
