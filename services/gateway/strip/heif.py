"""Strip HEIF and HEIC files (ISO/IEC 23008-12): rebuild Exif items, overwrite XMP and unknown boxes with zeros."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from capture2vr.gateway.strip import mp4
from capture2vr.gateway.strip.exif import clean_exif
from capture2vr.gateway.strip.in_place import (
    Buffer,
    CleanResult,
    UnreadableError,
    blank_all,
    is_blank,
    read_metadata,
    unique_names,
)
from capture2vr.gateway.strip.iso_boxes import Box, boxes, find, free_box
from capture2vr.sentences.sentence import say

_ALLOWED_BOXES = {b"ftyp", b"meta", b"mdat", b"moov"}
_ALLOWED_IN_META = {b"hdlr", b"pitm", b"iinf", b"iloc", b"iref", b"iprp", b"ipro", b"idat", b"dinf", b"grpl"}
# A deny list: a decoder refuses a picture that lacks a property marked as essential. Descriptions, and a maker's own.
_REMOVED_PROPERTIES = {b"udes", b"altt", b"uuid"}
_EXIF = b"Exif\0\0"  # what most writers put before the TIFF header
_MOST_ITEMS = 10_000  # a 100-megapixel photo has about 400 (tiles)
_MOST_METADATA = 64  # metadata items: two per picture of a short burst
_MOST_EXTENTS = 64  # pieces of one item: usually one, rarely some

Extent = tuple[int, int]
"""First and end byte in the file."""


def clean(data: Buffer) -> CleanResult:
    """Strip the metadata in place. Raises UnreadableError, also where an item lies outside of the file."""
    removed: list[str] = []
    meta: Box | None = None
    try:
        top = list(boxes(data, 0, len(data)))
        media = [(box.body, box.end) for box in top if box.kind == b"mdat"]
        for box in top:
            if box.kind == b"meta":
                meta = box
            elif box.kind == b"moov":
                removed += mp4.clean_sequence(data, box, media)
            elif box.kind not in _ALLOWED_BOXES:
                removed += [] if is_blank(data, box.body, box.end) else [box.kind.decode("latin-1")]
                free_box(data, box)
        if meta is None:
            raise UnreadableError(say("heif_file_has_no_index"))
        removed += _clean_items(data, meta) + _clean_index(data, meta)
    except struct.error:
        raise UnreadableError(say("heif_file_index_damaged_cut")) from None
    return CleanResult(unique_names(removed), len(data))


def _children(meta: Box) -> Box:
    """Return where the boxes in the index are: behind its version and flags."""
    return Box(b"meta", meta.start, meta.body + 4, meta.end)


def _clean_index(data: Buffer, meta: Box) -> list[str]:
    """Remove boxes of the index, and properties of pictures, that describe; return their names."""
    inner = _children(meta)
    found = [box for box in boxes(data, inner.body, inner.end) if box.kind not in _ALLOWED_IN_META]
    if (properties := find(data, inner, b"iprp", b"ipco")) is not None:  # they are told by their number: none may go
        found += (box for box in boxes(data, properties.body, properties.end) if box.kind in _REMOVED_PROPERTIES)
    removed = [box.kind.decode("latin-1") for box in found if not is_blank(data, box.body, box.end)]
    for box in found:
        free_box(data, box)
    return removed


def _clean_items(data: Buffer, meta: Box) -> list[str]:
    inner = _children(meta)
    kinds = _item_kinds(data, inner)
    extents_of = _item_extents(data, inner)
    exif = [extents for item, extents in extents_of.items() if kinds.get(item) == b"Exif"]
    other = [
        extent for item, extents in extents_of.items() if kinds.get(item) in (b"mime", b"uri ") for extent in extents
    ]
    if len(exif) + len(other) > _MOST_METADATA:
        raise UnreadableError(say("heif_file_has_too_many", count=len(exif) + len(other)))
    removed = [name for extents in exif for name in _clean_exif(data, extents)]
    if not all(is_blank(data, start, end) for start, end in other):
        removed.append("XMP")
        blank_all(data, other)
    return removed


def _clean_exif(data: Buffer, extents: Sequence[Extent]) -> Sequence[str]:
    content = b"".join(read_metadata(data, start, end) for start, end in extents[:_MOST_EXTENTS])
    if len(content) < 4:
        return ()
    # The item begins with the offset of the TIFF header, which may be wrong: readers look for that header themselves.
    header = 4 + len(_EXIF) if content[4:].startswith(_EXIF) else 4
    cleaned, removed = clean_exif(content[header:])
    block = content[:header] + cleaned
    for start, end in extents:
        data[start:end], block = block[: end - start], block[end - start :]
    return removed


def _item_kinds(data: Buffer, meta: Box) -> dict[int, bytes]:
    """Read the item information box (8.11.6): item number -> four-character type."""
    box = find(data, meta, b"iinf")
    if box is None:
        return {}
    entries = box.body + (6 if data[box.body] == 0 else 8)
    kinds = {}
    for entry in boxes(data, entries, box.end):
        wide = data[entry.body] >= 3
        item, _, kind = struct.unpack_from(">IH4s" if wide else ">HH4s", data, entry.body + 4)
        kinds[item] = kind
    return kinds


@dataclass(slots=True)
class _IndexReader:
    """Reads consecutive big-endian integers."""

    data: Buffer
    at: int

    def take(self, size: int) -> int:
        if self.at + size > len(self.data):
            raise UnreadableError(say("heif_file_index_cut_short"))
        value = int.from_bytes(self.data[self.at : self.at + size], "big")
        self.at += size
        return value


def _item_extents(data: Buffer, meta: Box) -> dict[int, list[Extent]]:
    """Read the item location box (8.11.3): item number -> extents. Raises UnreadableError outside the file."""
    box = find(data, meta, b"iloc")
    if box is None:
        return {}
    store = find(data, meta, b"idat")
    reader = _IndexReader(data, box.body + 4)
    widths = _Widths.read(reader, version=data[box.body])
    count = reader.take(widths.item)
    if count > _MOST_ITEMS:
        raise UnreadableError(say("heif_file_has_too_many_items", count=count))
    items = (_read_item(reader, widths, 0 if store is None else store.body) for _ in range(count))
    return {item.number: item.extents for item in items if item.is_in_file}


@dataclass(frozen=True, slots=True)
class _Widths:
    """Bytes that each number of an item location box takes, 0 where the box has none; item: numbers of items too."""

    item: int
    method: int
    offset: int
    length: int
    base: int
    index: int

    @classmethod
    def read(cls, reader: _IndexReader, version: int) -> _Widths:
        sizes = reader.take(2)
        offset, length, base, index = (sizes >> shift & 15 for shift in (12, 8, 4, 0))
        return cls(2 if version < 2 else 4, 2 if version else 0, offset, length, base, index if version else 0)


@dataclass(frozen=True, slots=True)
class _Item:
    """Where an item lies, and by which method: in the file (0), in the index's own data (1), or within other items."""

    number: int
    method: int
    extents: list[Extent]

    @property
    def is_in_file(self) -> bool:
        return self.method < 2


def _read_item(reader: _IndexReader, widths: _Widths, store: int) -> _Item:
    """Read an item's place; store: where the index's own data begin. Raises UnreadableError outside the file."""
    item = _Item(reader.take(widths.item), reader.take(widths.method) & 15, [])
    reader.take(2)  # data reference index: always this file
    base = reader.take(widths.base) + (store if item.method == 1 else 0)
    for _ in range(reader.take(2)):
        if len(item.extents) > _MOST_EXTENTS:
            raise UnreadableError(say("item_heif_file", item=item.number, most=_MOST_EXTENTS))
        reader.take(widths.index)
        start = base + reader.take(widths.offset)
        end = start + reader.take(widths.length)
        if item.is_in_file and end > len(reader.data):
            raise UnreadableError(say("heif_file_cut_short_item", item=item.number, end=end))
        item.extents.append((start, end))
    return item
