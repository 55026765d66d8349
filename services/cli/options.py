"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

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
