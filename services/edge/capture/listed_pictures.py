"""Find the pictures that a recording's file lists, also where it has the paths and suffixes of another machine."""

from __future__ import annotations

import posixpath
import re
from collections import Counter
from collections.abc import Iterable

from capture2vr.edge.capture.files import Folder
from capture2vr.edge.capture.photos import SUFFIXES
from capture2vr.edge.errors import CaptureError

# Folders of pictures that have the photos' names and show something else: such a folder is never left out of a path.
_NO_PHOTOS = re.compile("depth|mask|normal|confidence|semantic|segment|alpha")

_Tails = dict[str, dict[str, str]]
"""Last parts of pictures' names, lower case and without suffix -> suffix -> name."""


def find_pictures(folder: Folder, written: Iterable[object], *, by: str) -> dict[str, str]:
    """Map each path `written` in the file `by` to the name of its picture in the capture; those not there are left out.

    Where there is no file at a path, the picture is the one that shares most of its last folders, whatever its suffix:
    programs write absolute paths, and photos are converted. Of several the shortest name counts, since smaller copies
    are in folders like `images_4`. A picture that more than one path leads to is none of theirs.
    Raises CAPTURE_UNREADABLE for what is no path; and for a path out of the capture's folder, unless others like it
    lead to pictures.
    """
    exact: dict[str, str] = {}
    others: list[str] = []
    outside: CaptureError | None = None
    for path in written:
        name, error = _resolve(folder, path, by)
        outside = outside or error
        if folder.has(name):
            exact[str(path)] = name
        else:
            others.append(str(path))
    alike = _alike_alone(folder, others, set(exact.values()))
    if outside is not None and not alike:
        raise outside
    return exact | alike


def _resolve(folder: Folder, path: object, by: str) -> tuple[str, CaptureError | None]:
    """Return the name that a path stands for; or "" and the error of a path that leads out of the folder.

    Raises CAPTURE_UNREADABLE for what is no path.
    """
    try:
        return folder.resolve(path, by=by), None
    except CaptureError as error:
        if not isinstance(path, str) or not _parts(path):
            raise
        return "", error


def _alike_alone(folder: Folder, paths: list[str], taken: set[str]) -> dict[str, str]:
    """Map paths to the pictures that are most like them, without those that are taken or that several are like."""
    tails = _tails(folder) if paths else {}
    deepest = max((tail.count("/") + 1 for tail in tails), default=0)
    found = {path: name for path in paths if (name := _alike(path, tails, deepest)) is not None and name not in taken}
    paths_to = Counter(found.values())
    return {path: name for path, name in found.items() if paths_to[name] == 1}


def _tails(folder: Folder) -> _Tails:
    tails: _Tails = {}
    for name in sorted(folder.names, key=len):
        stem, suffix = posixpath.splitext(name.lower())
        if suffix not in SUFFIXES:
            continue
        parts = stem.split("/")
        for at in range(len(parts)):
            if not at or not _NO_PHOTOS.search(parts[at - 1]):
                tails.setdefault("/".join(parts[at:]), {}).setdefault(suffix, name)
    return tails


def _alike(path: str, tails: _Tails, deepest: int) -> str | None:
    """Return the picture that shares most of the path's last parts, or None. deepest: the most parts that a tail has"""
    parts = _parts(path.lower())
    stem, suffix = posixpath.splitext(parts[-1]) if parts else ("", "")
    for at in range(len(parts)):
        if at and _NO_PHOTOS.search(parts[at - 1]):
            return None
        if at < len(parts) - deepest:  # a path of a million parts is joined no more than `deepest` times
            continue
        for last in (parts[-1], stem):
            if found := tails.get("/".join((*parts[at:-1], last))):
                return found.get(suffix) or next(iter(found.values()))
    return None


def _parts(path: str) -> list[str]:
    """Split a path as any system writes it."""
    return [part for part in re.split(r"[/\\]", path) if part not in ("", ".", "..")]
