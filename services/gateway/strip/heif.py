"""HEIF and HEIC (ISO/IEC 23008-12): Exif items are rebuilt, XMP items and unknown boxes become zeros."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from services.gateway.uploads import video
from services.gateway.uploads.boxes import Box, boxes, find, release
from services.gateway.uploads.cleaned import Buffer, Cleaned, UnreadableError, blank_all, is_blank, metadata, unique
from services.gateway.uploads.exif import cleaned_exif

_KEPT = {b"ftyp", b"meta", b"mdat", b"moov"}
_MOST_ITEMS = 10_000  # tiles of a 100-megapixel photo are about 400
_MOST_METADATA = 64  # blocks; two per picture of a short burst
_MOST_EXTENTS = 64  # pieces of one item; writers make one, rarely some

Extent = tuple[int, int]
"""First and end byte in the file."""


def clean(data: Buffer) -> Cleaned:
    """Metadata in place. Raises UnreadableError, too when an item's bytes are not in the file."""
    removed: list[str] = []
    meta: Box | None = None
    try:
        top = list(boxes(data, 0, len(data)))
        media = [(box.body, box.end) for box in top if box.kind == b"mdat"]
        for box in top:
            if box.kind == b"meta":
                meta = box
            elif box.kind == b"moov":
                removed += video.clean_sequence(data, box, media)
            elif box.kind not in _KEPT:
                removed += [] if is_blank(data, box.body, box.end) else [box.kind.decode("latin-1")]
                release(data, box)
        if meta is None:
            raise UnreadableError("the HEIF file has no index")
        removed += _clean_items(data, meta)
    except struct.error:
        raise UnreadableError("the HEIF file's index is damaged or cut short") from None
    return Cleaned(unique(removed), len(data))


def _clean_items(data: Buffer, meta: Box) -> list[str]:
    inner = Box(b"meta", meta.start, meta.body + 4, meta.end)  # behind version and flags
    kinds = _item_kinds(data, inner)
    places = _item_extents(data, inner)
    exif = [extents for item, extents in places.items() if kinds.get(item) == b"Exif"]
    other = [extent for item, extents in places.items() if kinds.get(item) in (b"mime", b"uri ") for extent in extents]
    if len(exif) + len(other) > _MOST_METADATA:
        raise UnreadableError(f"the HEIF file has {len(exif) + len(other):,} blocks of metadata")
    removed = [name for extents in exif for name in _clean_exif(data, extents)]
    if not all(is_blank(data, start, end) for start, end in other):
        removed.append("XMP")
        blank_all(data, other)
    return removed


def _clean_exif(data: Buffer, extents: Sequence[Extent]) -> Sequence[str]:
    content = b"".join(metadata(data, start, end) for start, end in extents[:_MOST_EXTENTS])
    if len(content) < 4:
        return ()
    header = 4 + struct.unpack_from(">I", content)[0]  # the item begins with the offset of the TIFF header
    cleaned, removed = cleaned_exif(content[header:])
    block = content[:header] + cleaned
    for start, end in extents:
        data[start:end], block = block[: end - start], block[end - start :]
    return removed


def _item_kinds(data: Buffer, meta: Box) -> dict[int, bytes]:
    """Item number → its four-character kind (8.11.6)."""
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
class _Reader:
    """Big-endian integers one after the other."""

    data: Buffer
    at: int

    def take(self, size: int) -> int:
        if self.at + size > len(self.data):
            raise UnreadableError("the HEIF file's index is cut short")
        value = int.from_bytes(self.data[self.at : self.at + size], "big")
        self.at += size
        return value


def _item_extents(data: Buffer, meta: Box) -> dict[int, list[Extent]]:
    """Item number → where its bytes are (8.11.3). Raises UnreadableError for bytes outside of the file."""
    box = find(data, meta, b"iloc")
    if box is None:
        return {}
    store = find(data, meta, b"idat")
    version = data[box.body]
    reader = _Reader(data, box.body + 4)
    sizes = reader.take(2)
    offset_size, length_size, base_size, index_size = (sizes >> shift & 15 for shift in (12, 8, 4, 0))
    count = reader.take(2 if version < 2 else 4)
    if count > _MOST_ITEMS:
        raise UnreadableError(f"the HEIF file has {count:,} items")
    found: dict[int, list[Extent]] = {}
    for _ in range(count):
        item = reader.take(2 if version < 2 else 4)
        method = reader.take(2) & 15 if version else 0
        reader.take(2)  # which file: always this one
        base = reader.take(base_size)
        if method == 1 and store is not None:
            base += store.body
        extents: list[Extent] = []
        for _ in range(reader.take(2)):
            if len(extents) > _MOST_EXTENTS:
                raise UnreadableError(f"the HEIF file has item {item} in more than {_MOST_EXTENTS} pieces")
            reader.take(index_size if version else 0)
            start = base + reader.take(offset_size)
            end = start + reader.take(length_size)
            if method < 2 and end > len(data):
                raise UnreadableError(f"the HEIF file is cut short: item {item} ends at byte {end:,}")
            extents.append((start, end))
        if method < 2:  # 2 would be parts of other items
            found[item] = extents
    return found
