"""What the format modules (jpeg, png, webp, heif, tiff, exr, video, matroska) have in common.

Each has `clean(data) -> Cleaned`. It works in place on a writable memory map and moves no byte, so that a 20 MB photo
costs no memory, offsets elsewhere in the file stay true, and the pixels are the same bits by construction.
"""

from __future__ import annotations

import mmap
import zlib
from collections.abc import Iterable
from dataclasses import dataclass

Buffer = bytearray | mmap.mmap


class UnreadableError(Exception):
    """The file is damaged or not what its first bytes say; the sentence tells where."""


@dataclass(frozen=True, slots=True)
class Cleaned:
    """removed: names of what was taken out, in order, each once; length: bytes to keep from the start of the file."""

    removed: tuple[str, ...]
    length: int


_BLOCK_BYTES = 1 << 20  # handled at once, so that a file of gigabytes costs no memory
_MOST_METADATA = 4 << 20  # bytes of one block of metadata; the largest real ones are maker notes of some 100 kB
MOST_PARTS = 100_000  # segments, chunks or boxes of one file; a film of an hour in fragments has some 10,000


def blank(data: Buffer, start: int, end: int) -> None:
    """Overwrite with zeros."""
    for at in range(start, end, _BLOCK_BYTES):
        stop = min(at + _BLOCK_BYTES, end)
        data[at:stop] = bytes(stop - at)


def is_blank(data: Buffer, start: int, end: int) -> bool:
    """Whether there are only zeros."""
    blocks = (data[at : min(at + _BLOCK_BYTES, end)] for at in range(start, end, _BLOCK_BYTES))
    return not any(block.strip(b"\0") for block in blocks)


def blank_all(data: Buffer, ranges: Iterable[tuple[int, int]]) -> None:
    """Overwrite ranges with zeros, each byte once however often a hostile index names it."""
    done = 0
    for start, end in sorted(ranges):
        blank(data, max(start, done), min(end, len(data)))
        done = max(done, end)


def metadata(data: Buffer, start: int, end: int) -> bytes:
    """A block to be looked into. Raises UnreadableError for one too big to be what it says."""
    if end - start > _MOST_METADATA:
        raise UnreadableError(f"the file has {end - start:,} bytes of metadata in one piece")
    return bytes(data[start:end])


def checksum(data: Buffer, start: int, end: int) -> int:
    """CRC-32 of a range, block by block."""
    value = 0
    for at in range(start, end, _BLOCK_BYTES):
        value = zlib.crc32(data[at : min(at + _BLOCK_BYTES, end)], value)
    return value


def unique(names: list[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(names))
