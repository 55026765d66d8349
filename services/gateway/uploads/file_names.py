"""Sanitize file names from browsers and apps: a path like `depth/0001.png` stays, path traversal is impossible."""

from __future__ import annotations

import re
import unicodedata
from pathlib import PurePosixPath

from capture2vr.process.archives import JUNK_NAMES

# ASCII characters with a special meaning in some file system or shell.
_UNSAFE_CHARACTERS = re.compile(r"[^\w .,()+@=\u0080-\U0010ffff-]")
_SEGMENT_BYTES = 150  # of the 255 that file systems allow: leaves space for a number that makes the name unique
_MOST_SEGMENTS = 8


def safe_name(name: str) -> str:
    """Return a safe relative path for an uploaded file; "" for `.DS_Store`, `Thumbs.db` and such, to be skipped."""
    segments = [part for part in re.split(r"[/\\]+", unicodedata.normalize("NFC", name)) if part.strip(". ")]
    if not segments or any(part in JUNK_NAMES for part in segments) or segments[-1].startswith("."):
        return ""
    return "/".join(_safe_segment(part) for part in segments[-_MOST_SEGMENTS:])


def _safe_segment(part: str) -> str:
    printable = "".join(letter if letter.isprintable() else "_" for letter in part)
    plain = _UNSAFE_CHARACTERS.sub("_", printable).strip(". ")
    stem, dot, suffix = plain.rpartition(".")
    stem, ending = (stem, dot + suffix) if dot and len(suffix) < 10 else (plain, "")
    short_stem = stem.encode()[: _SEGMENT_BYTES - len(ending.encode())].decode(errors="ignore")
    return (short_stem + ending) or "_"


def unique_name(name: str, used: dict[str, int]) -> str:
    """Return the name, with a number if it is used already: phones' cameras call every picture `image.jpg`.

    Case is ignored. used: lower-case name -> number to try next; the result is added to it
    """
    path, key = PurePosixPath(name), name.casefold()
    while name.casefold() in used:
        number = used[key]
        used[key] += 1
        name = str(path.with_name(f"{path.stem}-{number}{path.suffix}"))
    used[name.casefold()] = 2
    return name
