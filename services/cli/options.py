"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from capture2vr.errors import BadInput
from capture2vr.order.edits import LEAST_M, MOST_BYTES, MOST_M, NO_EDITS, Edits, InvalidEdits
from capture2vr.order.job_options import InvalidOption, check_columns
from capture2vr.order.option_table import OPTION_TABLE, Cut, Fill, VisibilityName
from capture2vr.order.photo_box import HOW, InvalidBox, PhotoBox
from capture2vr.order.reading import Unit

DEFAULT_GATEWAY = "http://127.0.0.1:8080"

Gateway = Annotated[str, typer.Option("--gateway", help="URL of the gateway.", envvar="CAPTURE2VR_GATEWAY")]
Trusted = Annotated[
    list[Path] | None,
    typer.Option(
        help="File of a public key (PEM) whose signatures are accepted; may be repeated. Default: those in "
        "STORAGE_TRUSTED_KEYS."
    ),
]
Open = Annotated[
    bool,
    typer.Option("--open", help="Let everybody who reaches the port in, without an access key, from anywhere."),
]


def _job_option(name: str, default: str = "", **limits: Any) -> Any:
    """An option of a job, with flag and help from their table; default: what the command does without it."""
    row = OPTION_TABLE[name]
    return typer.Option(row.flag, help=row.text(default), **limits)


PresetHere = Annotated[str, _job_option("preset", "chosen from the points")]
PresetThere = Annotated[str, _job_option("preset", "the gateway's")]
TargetOption = Annotated[str, _job_option("target")]
CutOption = Annotated[Cut | None, _job_option("cut")]
FillOption = Annotated[Fill | None, _job_option("fill")]
Columns = Annotated[str, _job_option("columns")]
UnitOption = Annotated[Unit | None, _job_option("unit")]
Longest = Annotated[float | None, _job_option("longest_m", min=LEAST_M, max=int(MOST_M))]
Box = Annotated[str, _job_option("box")]
EditsFile = Annotated[Path | None, _job_option("edits")]
Label = Annotated[str, _job_option("label")]
Description = Annotated[str, _job_option("description")]
Tags = Annotated[list[str] | None, _job_option("labels")]
Collection = Annotated[str, _job_option("collection", envvar="STORAGE_COLLECTION")]
PublishAnyway = Annotated[bool, _job_option("publish_anyway")]
VisibilityOption = Annotated[VisibilityName | None, _job_option("visibility")]


def parse_box(text: str) -> PhotoBox | None:
    """Parse the option --box; None where it is not given. Raises BadInput."""
    try:
        return PhotoBox.parse(text) if text else None
    except InvalidBox as error:
        raise BadInput(f"--box: {error} ({HOW})") from None


def parse_columns(text: str) -> str:
    """Return the option --columns as it is. Raises BadInput for columns that there cannot be."""
    try:
        return check_columns(text)
    except InvalidOption as error:
        raise BadInput(f"--{error}") from None


def read_edits(path: Path | None) -> Edits:
    """Read the file of the option --edits; the empty recipe where it is not given. Raises BadInput."""
    if path is None:
        return NO_EDITS
    try:
        with path.open("rb") as file:
            return Edits.parse(file.read(MOST_BYTES + 1))
    except InvalidEdits as error:
        raise BadInput(f"{path}: {error} (docs/edits.md describes a recipe)") from None
    except OSError as error:
        raise BadInput(f"{path} cannot be read: {error.strerror}; name a recipe with --edits") from None
