"""Tell raw photos by their names: what a camera's sensor measured, which is not read here.

Many are TIFF files by their first bytes, with a small preview as their first picture; that must not be taken for the
photo.
"""

from __future__ import annotations

from pathlib import PurePosixPath

_SUFFIXES = {".dng", ".cr2", ".cr3", ".crw", ".nef", ".nrw", ".arw", ".sr2", ".srf", ".pef", ".raf", ".orf", ".rw2"}
_SUFFIXES |= {".srw", ".3fr", ".fff", ".iiq", ".mos", ".erf", ".kdc", ".dcr", ".mef", ".rwl", ".gpr"}


def is_raw_photo(name: str) -> bool:
    """Return whether a file's name is that of a raw photo."""
    return PurePosixPath(name).suffix.lower() in _SUFFIXES
