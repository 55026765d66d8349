"""File names from browsers and apps: a path like `depth/0001.png` stays, whatever could lead elsewhere does not."""

from __future__ import annotations

import re
import unicodedata
from pathlib import PurePosixPath

_ODD = re.compile(r"[^\w .,()+@=\u0080-\U0010ffff-]")  # ASCII that some file system or shell gives a meaning
_SEGMENT_BYTES = 150  # of the 255 that file systems take: room for a number that makes the name unique
_MOST_SEGMENTS = 8
_DROPPED = {"__MACOSX", "Thumbs.db", "desktop.ini"}


def safe_name(given: str) -> str:
    """A relative path in the upload, or "" for a file that nobody meant to send (`.DS_Store`, `Thumbs.db`)."""
    segments = [part for part in re.split(r"[/\\]+", unicodedata.normalize("NFC", given)) if part.strip(". ")]
    if not segments or any(part in _DROPPED for part in segments) or segments[-1].startswith("."):
        return ""
    return "/".join(_safe_segment(part) for part in segments[-_MOST_SEGMENTS:])


def _safe_segment(part: str) -> str:
    printable = "".join(letter if letter.isprintable() else "_" for letter in part)
    plain = _ODD.sub("_", printable).strip(". ")
    stem, dot, suffix = plain.rpartition(".")
    stem, ending = (stem, dot + suffix) if dot and len(suffix) < 10 else (plain, "")
    cut = stem.encode()[: _SEGMENT_BYTES - len(ending.encode())].decode(errors="ignore")
    return (cut + ending) or "_"


def unique_name(name: str, taken: dict[str, int]) -> str:
    """The name, numbered if it is taken: a phone's camera calls every picture `image.jpg`. Case does not count.

    `taken` holds, by name, the number to try next; the answer is entered there.
    """
    path, wanted = PurePosixPath(name), name.casefold()
    while name.casefold() in taken:
        number = taken[wanted]
        taken[wanted] += 1
        name = str(path.with_name(f"{path.stem}-{number}{path.suffix}"))
    taken[name.casefold()] = 2
    return name
