"""TIFF 6.0: entries that name person or place leave their directories; strips of pixels stay where they are."""

from __future__ import annotations

import itertools
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field

from services.gateway.uploads.cleaned import Buffer, Cleaned, UnreadableError, blank_all, unique
from services.gateway.uploads.exif import BrokenExifError, byte_order, field_bytes, tag_name

# Here what goes is listed: a TIFF's directory also says where its pixels are, in more ways than a list would cover.
_REMOVED = {
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
_REMOVED |= {0x9C9B, 0x9C9C, 0x9C9D, 0x9C9E, 0x9C9F, 0x927C, 0x9286}
_DIRECTORIES = {0x8769, 0x8825}  # tags whose value is a directory of its own: Exif, GPS
_MOST_ENTRIES = 1_000  # in a directory within another
_MOST_VALUES = 10_000  # of metadata; real files have some hundred
_MOST_PAGES = 64  # a loop of directories must end


@dataclass(slots=True)
class _Found:
    """Names of removed entries, where their values are, and the directories within directories already looked into."""

    removed: list[str] = field(default_factory=list)
    ranges: list[tuple[int, int]] = field(default_factory=list)
    seen: set[int] = field(default_factory=set)


def clean(data: Buffer) -> Cleaned:
    """Metadata in place. Raises UnreadableError where a directory leads nowhere."""
    found = _Found()
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
    return Cleaned(unique(found.removed), len(data))


def _clean_directory(data: Buffer, order: str, offset: int, found: _Found) -> int:
    """Close the gaps that removed entries leave, note where their values are; the offset of the next directory."""
    count = struct.unpack_from(order + "H", data, offset)[0]
    end = offset + 2 + 12 * count
    next_offset = int(struct.unpack_from(order + "I", data, end)[0])
    kept = []
    for at in range(offset + 2, end, 12):
        tag = struct.unpack_from(order + "H", data, at)[0]
        if tag not in _REMOVED:
            kept.append(bytes(data[at : at + 12]))
            continue
        found.removed.append(tag_name(tag))
        found.ranges += itertools.islice(_value_ranges(data, order, at, found.seen), _MOST_VALUES + 1)
        if len(found.ranges) > _MOST_VALUES:
            raise UnreadableError(f"the TIFF has more than {_MOST_VALUES:,} values of metadata")
    struct.pack_into(order + "H", data, offset, len(kept))
    rest = b"".join(kept) + struct.pack(order + "I", next_offset)
    data[offset + 2 : end + 4] = rest.ljust(end + 2 - offset, b"\0")
    return next_offset


def _value_ranges(data: Buffer, order: str, at: int, seen: set[int]) -> Iterator[tuple[int, int]]:
    """First and end byte of what an entry points at, and of all that its directory points at, if it is one."""
    tag, kind, number, pointer = struct.unpack_from(order + "HHII", data, at)
    size = field_bytes(kind, number)
    if size > 4:
        yield _within(data, pointer, size)
    elif tag in _DIRECTORIES and pointer not in seen:
        seen.add(pointer)
        count = struct.unpack_from(order + "H", data, pointer)[0]
        if count > _MOST_ENTRIES or len(seen) > _MOST_PAGES:
            raise UnreadableError("the TIFF is damaged: its directories do not end")
        yield _within(data, pointer, 2 + 12 * count)
        for inner in range(pointer + 2, pointer + 2 + 12 * count, 12):
            yield from _value_ranges(data, order, inner, seen)


def _within(data: Buffer, start: int, size: int) -> tuple[int, int]:
    if start + size > len(data):
        raise UnreadableError("the TIFF is damaged: a value ends outside of the file")
    return start, start + size
