"""Strip TIFF 6.0 files: remove directory entries that identify persons or places; pixel strips stay in place."""

from __future__ import annotations

import itertools
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field

from services.gateway.strip.exif import BrokenExifError, byte_order, field_bytes, tag_name
from services.gateway.strip.in_place import Buffer, CleanResult, UnreadableError, blank_all, unique_names

# A deny list here: a TIFF's directory also says where its pixels are, in more ways than an allow list would cover.
_REMOVED_TAGS = {
    0x010E,
    0x013B,
    0x013C,
    0x02BC,
    0x8298,
    0x83BB,
    0x8649,
    0x8769,
    0x8825,
    0xA420,
    0xA430,
    0xA431,
    0xA435,
    0xC62F,
}
_REMOVED_TAGS |= {0x9C9B, 0x9C9C, 0x9C9D, 0x9C9E, 0x9C9F, 0x927C, 0x9286}
_DIRECTORIES = {0x8769, 0x8825}  # tags whose value is a directory of its own: Exif, GPS
_MOST_ENTRIES = 1_000  # of a nested directory
_MOST_VALUES = 10_000  # metadata values; real files have a few hundred
_MOST_PAGES = 64  # directories: ends a hostile loop of them


@dataclass(slots=True)
class _RemovedEntries:
    """Names of the removed entries, byte ranges of their values, and offsets of nested directories visited so far."""

    removed: list[str] = field(default_factory=list)
    ranges: list[tuple[int, int]] = field(default_factory=list)
    visited: set[int] = field(default_factory=set)


def clean(data: Buffer) -> CleanResult:
    """Strip the metadata in place. Raises UnreadableError for a damaged file."""
    found = _RemovedEntries()
    try:
        order = byte_order(bytes(data[:4]))
        offset = struct.unpack_from(order + "I", data, 4)[0]
        for _ in range(_MOST_PAGES):
            if offset == 0:
                break
            offset = _clean_directory(data, order, offset, found)
    except (struct.error, BrokenExifError) as error:
        raise UnreadableError(f"the TIFF is damaged or cut short: {error}") from None
    blank_all(data, found.ranges)
    return CleanResult(unique_names(found.removed), len(data))


def _clean_directory(data: Buffer, order: str, offset: int, found: _RemovedEntries) -> int:
    """Remove entries from a directory, record the ranges of their values, and return the next directory's offset."""
    count = struct.unpack_from(order + "H", data, offset)[0]
    end = offset + 2 + 12 * count
    next_offset = int(struct.unpack_from(order + "I", data, end)[0])
    remaining = []
    for at in range(offset + 2, end, 12):
        tag = struct.unpack_from(order + "H", data, at)[0]
        if tag not in _REMOVED_TAGS:
            remaining.append(bytes(data[at : at + 12]))
            continue
        found.removed.append(tag_name(tag))
        found.ranges += itertools.islice(_value_ranges(data, order, at, found.visited), _MOST_VALUES + 1)
        if len(found.ranges) > _MOST_VALUES:
            raise UnreadableError(f"the TIFF has too many metadata values: more than {_MOST_VALUES:,}")
    struct.pack_into(order + "H", data, offset, len(remaining))
    rest = b"".join(remaining) + struct.pack(order + "I", next_offset)
    data[offset + 2 : end + 4] = rest.ljust(end + 2 - offset, b"\0")
    return next_offset


def _value_ranges(data: Buffer, order: str, at: int, visited: set[int]) -> Iterator[tuple[int, int]]:
    """Yield the byte range of an entry's value; for a nested directory also those of all its values."""
    tag, kind, number, pointer = struct.unpack_from(order + "HHII", data, at)
    size = field_bytes(kind, number)
    if size > 4:
        yield _within(data, pointer, size)
    elif tag in _DIRECTORIES and pointer not in visited:
        visited.add(pointer)
        count = struct.unpack_from(order + "H", data, pointer)[0]
        if count > _MOST_ENTRIES or len(visited) > _MOST_PAGES:
            raise UnreadableError("the TIFF is damaged: its directories do not end")
        yield _within(data, pointer, 2 + 12 * count)
        for inner in range(pointer + 2, pointer + 2 + 12 * count, 12):
            yield from _value_ranges(data, order, inner, visited)


def _within(data: Buffer, start: int, size: int) -> tuple[int, int]:
    if start + size > len(data):
        raise UnreadableError("the TIFF is damaged: a value ends outside of the file")
    return start, start + size
