"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from capture2vr.cli.errors import BadInput
from capture2vr.order.edits import MOST_BYTES, NO_EDITS, Edits, InvalidEdits
from capture2vr.order.photo_box import HOW, InvalidBox, PhotoBox

DEFAULT_GATEWAY = "http://127.0.0.1:8080"

Gateway = Annotated[str, typer.Option("--gateway", help="URL of the gateway.", envvar="CAPTURE2VR_GATEWAY")]
Collection = Annotated[str, typer.Option("--collection", help="Name of the collection.", envvar="STORAGE_COLLECTION")]
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
Tags = Annotated[
    list[str] | None,
    typer.Option("--tag", help="A tag of the asset, such as summer; may be repeated."),
]
Box = Annotated[
    str,
    typer.Option(
        help="Rectangle around the object in a single photo: left,top,right,bottom as shares of the upright photo's "
        "width and height, such as 0.2,0.1,0.8,0.95. Default: what stands out, else the largest object near the middle."
    ),
]

EditsFile = Annotated[
    Path | None,
    typer.Option(
        "--edits",
        help="Recipe (JSON) of what to cut away, which way is up and the true size, such as `edits` of a manifest. "
        "What it says of cut, fill, preset and target holds where the command line says nothing.",
    ),
]


def parse_box(text: str) -> PhotoBox | None:
    """Parse the option --box; None where it is not given. Raises BadInput."""
    try:
        return PhotoBox.parse(text) if text else None
    except InvalidBox as error:
        raise BadInput(f"--box: {error} ({HOW})") from None


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
