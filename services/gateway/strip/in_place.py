"""Helpers to strip metadata in place, for the formats' modules (jpeg, png, webp, heif, tiff, exr, e57, mp4, matroska).

Each of those has `clean(data) -> CleanResult`, which works on a writable memory map and moves no byte. So a 20 MB photo
costs no memory, offsets in the file stay valid, and the pixels stay bit-identical.
"""

from __future__ import annotations

import mmap
import zlib
from collections.abc import Iterable
from dataclasses import dataclass

from capture2vr.sentences.sentence import say

Buffer = bytearray | mmap.mmap


class UnreadableError(Exception):
    """The file is damaged, or not of the type that its first bytes claim. The message says where."""


@dataclass(frozen=True, slots=True)
class CleanResult:
    """Result of stripping a file.

    removed  names of the removed metadata, in order, each once
    length   bytes to keep from the start of the file
    """

    removed: tuple[str, ...]
    length: int


_BLOCK_BYTES = 1 << 20  # per step, so that a file of gigabytes costs no memory
_MOST_METADATA = 4 << 20  # bytes of one block of metadata; the largest real ones are maker notes of about 100 kB
MOST_PARTS = 100_000  # segments, chunks or boxes of one file; a fragmented video of an hour has about 10,000


def blank(data: Buffer, start: int, end: int) -> None:
    """Overwrite a range with zeros."""
    for at in range(start, end, _BLOCK_BYTES):
        stop = min(at + _BLOCK_BYTES, end)
        data[at:stop] = bytes(stop - at)


def is_blank(data: Buffer, start: int, end: int) -> bool:
    """Return whether a range has only zeros."""
    blocks = (data[at : min(at + _BLOCK_BYTES, end)] for at in range(start, end, _BLOCK_BYTES))
    return not any(block.strip(b"\0") for block in blocks)


def blank_all(data: Buffer, ranges: Iterable[tuple[int, int]]) -> None:
    """Overwrite ranges with zeros; each byte only once, even if a hostile index lists it many times."""
    done = 0
    for start, end in sorted(ranges):
        blank(data, max(start, done), min(end, len(data)))
        done = max(done, end)


def read_metadata(data: Buffer, start: int, end: int) -> bytes:
    """Copy a block of metadata to be parsed. Raises UnreadableError for one that is too large."""
    if end - start > _MOST_METADATA:
        raise UnreadableError(say("file_has_block_metadata", size=end - start))
    return bytes(data[start:end])


def checksum(data: Buffer, start: int, end: int) -> int:
    """Return the CRC-32 of a range, computed block by block."""
    value = 0
    for at in range(start, end, _BLOCK_BYTES):
        value = zlib.crc32(data[at : min(at + _BLOCK_BYTES, end)], value)
    return value


def unique_names(names: list[str]) -> tuple[str, ...]:
    """Return the names in order, each once."""
    return tuple(dict.fromkeys(names))
