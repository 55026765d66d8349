"""Strip TIFF 6.0 files: remove directory entries that identify persons or places; pixel strips stay in place."""

from __future__ import annotations

import itertools
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from capture2vr.gateway.strip.exif import ALLOWED_EXIF_TAGS, BrokenExifError, byte_order, field_bytes, tag_name
from capture2vr.gateway.strip.in_place import Buffer, CleanResult, UnreadableError, blank_all, unique_names
from capture2vr.sentences.sentence import say

# A deny list for the tags of the standard: they also say where the pixels are, in more ways than an allow list would
# cover. Description, names of document, page and printer, artist, computer, XMP.
_REMOVED_TAGS = {0x010D, 0x010E, 0x011D, 0x013B, 0x013C, 0x0151, 0x02BC}
# An allow list for private tags, from 0x8000 on, so that a maker's new ones are removed too, and places of maps
# (GeoTIFF). Matte, type and depth of samples; raw patterns; TIFF/IT; ICC profile; units; LERC; the mark of a raw photo.
_PRIVATE = 0x8000
_ALLOWED_PRIVATE_TAGS = {0x80E3, 0x80E4, 0x80E5, 0x80E6, 0x828D, 0x828E, 0x8773, 0x923F, 0xC5F2, 0xC612, 0xC613}
_ALLOWED_PRIVATE_TAGS |= set(range(0x84E0, 0x84F2))
_SUB_IMAGES, _EXIF = 0x014A, 0x8769  # tags whose values are directories that stay
_DIRECTORIES = {0x8825}  # a tag whose value is a directory that goes: GPS
_ALLOWED_PRIVATE_TAGS |= {_EXIF} | ALLOWED_EXIF_TAGS
_MAKER_NOTE = 0x927C
_MOST_ENTRIES = 1_000  # of a nested directory
_MOST_VALUES = 10_000  # metadata values; real files have a few hundred
_MOST_DIRECTORIES = 1_000  # pages, sub-images and Exif together

Keeps = Callable[[int], bool]
"""Whether a directory's entry with this tag stays."""


@dataclass(slots=True)
class _CleanedTiff:
    """State while a file is stripped.

    removed      names of the removed entries
    ranges       byte ranges of their values
    nested       offsets of directories of removed entries, visited so far
    directories  offsets of directories that stay and are still to be stripped, and what stays in them
    """

    removed: list[str] = field(default_factory=list)
    ranges: list[tuple[int, int]] = field(default_factory=list)
    nested: set[int] = field(default_factory=set)
    directories: list[tuple[int, Keeps]] = field(default_factory=list)


def clean(data: Buffer) -> CleanResult:
    """Strip the metadata in place, of every page and sub-image. Raises UnreadableError for a damaged file."""
    tiff, visited = _CleanedTiff(), {0}
    try:
        order = byte_order(bytes(data[:4]))
        tiff.directories.append((struct.unpack_from(order + "I", data, 4)[0], _stays_in_image))
        while tiff.directories:
            offset, keeps = tiff.directories.pop()
            if offset in visited:
                continue
            visited.add(offset)
            if len(visited) > _MOST_DIRECTORIES:
                raise UnreadableError(say("tiff_has_too_many_pages", most=_MOST_DIRECTORIES))
            _clean_directory(data, order, offset, keeps, tiff)
    except (struct.error, BrokenExifError) as error:
        raise UnreadableError(say("tiff_damaged_cut_short", error=error)) from None
    blank_all(data, tiff.ranges)
    return CleanResult(unique_names(tiff.removed), len(data))


def _stays_in_image(tag: int) -> bool:
    if tag >= _PRIVATE:
        return tag in _ALLOWED_PRIVATE_TAGS and tag != _MAKER_NOTE
    return tag not in _REMOVED_TAGS


def _stays_in_exif(tag: int) -> bool:
    return tag in ALLOWED_EXIF_TAGS and tag != _MAKER_NOTE


def _clean_directory(data: Buffer, order: str, offset: int, keeps: Keeps, tiff: _CleanedTiff) -> None:
    """Remove entries from a directory, record the ranges of their values, and the directories that it leads to."""
    end = offset + 2 + 12 * _count(data, order, offset)
    next_offset = int(struct.unpack_from(order + "I", data, end)[0])
    tiff.directories.append((next_offset, keeps))
    remaining = []
    for at in range(offset + 2, end, 12):
        tag = struct.unpack_from(order + "H", data, at)[0]
        if keeps(tag):
            remaining.append(bytes(data[at : at + 12]))
            if tag in (_SUB_IMAGES, _EXIF):
                inner = _stays_in_exif if tag == _EXIF else _stays_in_image
                tiff.directories += ((each, inner) for each in _pointers(data, order, at))
            continue
        tiff.removed.append(tag_name(tag))
        tiff.ranges += itertools.islice(_value_ranges(data, order, at, tiff.nested), _MOST_VALUES + 1)
        if len(tiff.ranges) > _MOST_VALUES:
            raise UnreadableError(say("tiff_has_too_many_metadata", most=_MOST_VALUES))
    struct.pack_into(order + "H", data, offset, len(remaining))
    rest = b"".join(remaining) + struct.pack(order + "I", next_offset)
    data[offset + 2 : end + 4] = rest.ljust(end + 2 - offset, b"\0")


def _count(data: Buffer, order: str, offset: int) -> int:
    """Read the number of a directory's entries. Raises UnreadableError for more than any has."""
    count = int(struct.unpack_from(order + "H", data, offset)[0])
    if count > _MOST_ENTRIES:
        raise UnreadableError(say("tiff_damaged_one_directories", count=count))
    return count


def _pointers(data: Buffer, order: str, at: int) -> tuple[int, ...]:
    """Read the offsets of the directories that an entry leads to. Raises UnreadableError, BrokenExifError."""
    _, kind, number, pointer = struct.unpack_from(order + "HHII", data, at)
    if field_bytes(kind, number) != 4 * number or number > _MOST_DIRECTORIES:
        raise UnreadableError(say("tiff_damaged_entry_should_lead"))
    return (pointer,) if number == 1 else struct.unpack_from(f"{order}{number}I", data, pointer)


def _value_ranges(data: Buffer, order: str, at: int, visited: set[int]) -> Iterator[tuple[int, int]]:
    """Yield the byte range of an entry's value; for a nested directory also those of all its values."""
    tag, kind, number, pointer = struct.unpack_from(order + "HHII", data, at)
    size = field_bytes(kind, number)
    if size > 4:
        yield _within(data, pointer, size)
    elif tag in _DIRECTORIES and pointer not in visited:
        visited.add(pointer)
        count = _count(data, order, pointer)
        if len(visited) > _MOST_DIRECTORIES:
            raise UnreadableError(say("tiff_damaged_directories"))
        yield _within(data, pointer, 2 + 12 * count)
        for inner in range(pointer + 2, pointer + 2 + 12 * count, 12):
            yield from _value_ranges(data, order, inner, visited)


def _within(data: Buffer, start: int, size: int) -> tuple[int, int]:
    if start + size > len(data):
        raise UnreadableError(say("tiff_damaged_value_ends_outside"))
    return start, start + size
