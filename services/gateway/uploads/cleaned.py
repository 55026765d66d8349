"""What the format modules (jpeg, png, webp, heif, tiff, exr, video) have in common.

Each has `clean(data) -> Cleaned`. It works in place on a writable memory map and moves no byte, so that a 20 MB photo
costs no memory, offsets elsewhere in the file stay true, and the pixels are the same bits by construction.
"""

from __future__ import annotations

import mmap
from dataclasses import dataclass

Buffer = bytearray | mmap.mmap


class UnreadableError(Exception):
    """The file is damaged or not what its first bytes say; the sentence tells where."""


@dataclass(frozen=True, slots=True)
class Cleaned:
    """removed: names of what was taken out, in order, each once; length: bytes to keep from the start of the file."""

    removed: tuple[str, ...]
    length: int


def blank(data: Buffer, start: int, end: int) -> None:
    """Overwrite with zeros."""
    data[start:end] = bytes(end - start)


def unique(names: list[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(names))
