"""EXIF without person and place: a TIFF structure (TIFF 6.0, Exif 2.32) rebuilt from the tags that are needed.

What stays is listed, not what goes: a maker's new private tag is gone before anybody hears of it. The rebuilt block is
padded with zeros to the old length, so it goes back into its container in place.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

_EXIF_IFD = 0x8769
# Orientation, size, resolution, make and model: how to read the picture, and which lens model it may have.
_KEPT_IMAGE = {
    0x0100,
    0x0101,
    0x0102,
    0x0103,
    0x0106,
    0x010F,
    0x0110,
    0x0112,
    0x0115,
    0x011A,
    0x011B,
    0x0128,
    0x0132,
    0x0213,
}
# Exposure (order and brightness of a series), times of day without zone, focal lengths, sizes, the lens' kind.
_KEPT_EXIF = (
    {0x829A, 0x829D, 0x8822, 0x8827, 0x9000, 0x9003, 0x9004, 0x9101, 0xA000, 0xA001, 0xA002, 0xA003}
    | set(range(0x9201, 0x920B))  # shutter, aperture, brightness, bias, distance, metering, light, flash, focal length
    | {0x9290, 0x9291, 0x9292, 0xA20E, 0xA20F, 0xA210, 0xA217}
    | set(range(0xA401, 0xA40D))
    | {0xA432, 0xA433, 0xA434}
)
_NAMES = {
    0x010E: "ImageDescription",
    0x0131: "Software",
    0x013B: "Artist",
    0x013C: "HostComputer",
    0x02BC: "XMP",
    0x8298: "Copyright",
    0x83BB: "IPTC",
    0x8649: "Photoshop",
    0x8769: "Exif",
    0x8825: "GPSInfo",
    0x9010: "OffsetTime",
    0x9011: "OffsetTimeOriginal",
    0x9012: "OffsetTimeDigitized",
    0x927C: "MakerNote",
    0x9286: "UserComment",
    0x9C9D: "XPAuthor",
    0xA005: "Interoperability",
    0xA420: "ImageUniqueID",
    0xA430: "CameraOwnerName",
    0xA431: "BodySerialNumber",
    0xA435: "LensSerialNumber",
    0xC62F: "CameraSerialNumber",
}
_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4}  # bytes per TIFF field type
_MOST_ENTRIES = 1000  # in one directory; cameras write about 60


class BrokenExifError(ValueError):
    """The block's offsets or counts make no sense."""


@dataclass(frozen=True, slots=True)
class _Field:
    tag: int
    kind: int
    count: int
    value: bytes


@dataclass(slots=True)
class _Directory:
    fields: list[_Field] = field(default_factory=list)
    removed: list[str] = field(default_factory=list)
    next_offset: int = 0


def cleaned_exif(block: bytes) -> tuple[bytes, tuple[str, ...]]:
    """The block with only harmless tags, as long as before, and the names of those removed; a broken one as zeros."""
    try:
        rebuilt, removed = _rebuilt(block)
    except (BrokenExifError, struct.error):
        return bytes(len(block)), ("Exif",)
    if not removed:
        return block, ()
    if len(rebuilt) > len(block):  # values that shared their bytes no longer do
        return bytes(len(block)), (*removed, "Exif")
    return rebuilt.ljust(len(block), b"\0"), removed


def tag_name(tag: int) -> str:
    """The name of a tag in a report."""
    return _NAMES.get(tag, f"Tag{tag:#06x}")


def field_bytes(kind: int, count: int) -> int:
    """Size of a field's value. Raises BrokenExifError for a type that TIFF does not have."""
    if kind not in _SIZES:
        raise BrokenExifError(f"field type {kind}")
    return _SIZES[kind] * count


def byte_order(block: bytes) -> str:
    """`<` or `>`. Raises BrokenExifError for what is no TIFF structure."""
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(bytes(block[:4]))
    if order is None:
        raise BrokenExifError("no TIFF header")
    return order


def _rebuilt(block: bytes) -> tuple[bytes, tuple[str, ...]]:
    order = byte_order(block)
    image = _directory(block, order, struct.unpack_from(order + "I", block, 4)[0], _KEPT_IMAGE | {_EXIF_IFD})
    exif = _Directory()
    fields = []
    for each in image.fields:
        if each.tag == _EXIF_IFD:
            exif = _directory(block, order, struct.unpack(order + "I", each.value)[0], _KEPT_EXIF)
        else:
            fields.append(each)
    removed = image.removed + exif.removed + (["Thumbnail"] if image.next_offset else [])
    return _written(order, fields, exif.fields), tuple(dict.fromkeys(removed))


def _directory(block: bytes, order: str, offset: int, kept: set[int]) -> _Directory:
    count = struct.unpack_from(order + "H", block, offset)[0]
    if count > _MOST_ENTRIES:
        raise BrokenExifError(f"{count} entries")
    found, total = _Directory(), 0
    for at in range(offset + 2, offset + 2 + 12 * count, 12):
        tag, kind, number, pointer = struct.unpack_from(order + "HHII", block, at)
        if tag not in kept:
            found.removed.append(tag_name(tag))
            continue
        size = field_bytes(kind, number)
        start = at + 8 if size <= 4 else pointer
        total += size
        if start + size > len(block) or total > len(block):  # values that overlap must not add up to gigabytes
            raise BrokenExifError(f"{tag_name(tag)} ends outside of the block")
        found.fields.append(_Field(tag, kind, number, bytes(block[start : start + size])))
    end = offset + 2 + 12 * count
    found.next_offset = struct.unpack_from(order + "I", block, end)[0] if end + 4 <= len(block) else 0
    return found


def _written(order: str, image: list[_Field], exif: list[_Field]) -> bytes:
    """A TIFF structure of one image directory and, behind it, its Exif directory."""
    header = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(order + "I", 8)
    exif_at = 8 + len(_packed(order, [*image, _pointer(order, 0)], 8))
    if not exif:
        return header + _packed(order, image, 8)
    return header + _packed(order, [*image, _pointer(order, exif_at)], 8) + _packed(order, exif, exif_at)


def _pointer(order: str, offset: int) -> _Field:
    return _Field(_EXIF_IFD, 4, 1, struct.pack(order + "I", offset))


def _packed(order: str, fields: list[_Field], offset: int) -> bytes:
    """One directory that will lie at `offset`, with the values that do not fit into their entries behind it."""
    fields = sorted(fields, key=lambda each: each.tag)
    entries, values = struct.pack(order + "H", len(fields)), b""
    values_at = offset + 2 + 12 * len(fields) + 4
    for each in fields:
        entries += struct.pack(order + "HHI", each.tag, each.kind, each.count)
        if len(each.value) <= 4:
            entries += each.value.ljust(4, b"\0")
        else:
            entries += struct.pack(order + "I", values_at + len(values))
            values += each.value + b"\0" * (len(each.value) % 2)  # values begin at even offsets
    return entries + bytes(4) + values
