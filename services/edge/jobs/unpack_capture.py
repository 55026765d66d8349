"""Unpack the archive of a capture."""

from __future__ import annotations

from pathlib import Path

from capture2vr.edge.errors import CaptureError
from capture2vr.process.archives import ArchiveError, unpack


def unpack_capture(archive: Path, scratch: Path) -> Path:
    """Unpack an archive into a folder in `scratch`, and return the folder. Raises CaptureError."""
    folder = scratch / "capture"
    try:
        unpack(archive, folder)
    except ArchiveError as error:
        raise CaptureError(error.code, error.message, file=error.file, hints=error.hints) from None
    return folder
