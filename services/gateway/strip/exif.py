"""Strip EXIF (TIFF 6.0, Exif 2.32) of location and personal data: rebuild the block from an allow list of tags.

An allow list, so that a maker's new private tags are removed too. The rebuilt block is padded with zeros to the old
length, so that it replaces the old one in place. Which way was down stays: the camera's elevation, and of an iPhone's
maker note the acceleration alone (apple_maker_note.py). It tells nothing about a person or a place, and
without it the reconstruction must guess what is upright.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

from capture2vr.order.apple_maker_note import acceleration_note

_EXIF_IFD = 0x8769
_MAKER_NOTE, _UNDEFINED = 0x927C, 7  # tag, and its field type
_ELEVATION = 0x9405  # CameraElevationAngle: of the optical axis over the horizon
# Image size, orientation, resolution, make and model: needed to decode the image, and to guess its lens.
_ALLOWED_IMAGE_TAGS = {
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
# Exposure (order and brightness of a series), times without time zone, focal lengths, sizes, lens type.
ALLOWED_EXIF_TAGS = (
    {0x829A, 0x829D, 0x8822, 0x8827, 0x9000, 0x9003, 0x9004, 0x9101, 0xA000, 0xA001, 0xA002, 0xA003}
    | set(range(0x9201, 0x920B))  # shutter, aperture, brightness, bias, distance, metering, light, flash, focal length
    | {_ELEVATION, _MAKER_NOTE, 0x9290, 0x9291, 0x9292, 0xA20E, 0xA20F, 0xA210, 0xA217}
    | set(range(0xA401, 0xA40D))
    | {0xA432, 0xA433, 0xA434}
)
_NAMES = {
    0x010D: "DocumentName",
    0x010E: "ImageDescription",
    0x0131: "Software",
    0x013B: "Artist",
    0x013C: "HostComputer",
    0x02BC: "XMP",
    0x8298: "Copyright",
    0x830E: "ModelPixelScale",
    0x83BB: "IPTC",
    0x8482: "ModelTiepoint",
    0x85D8: "ModelTransformation",
    0x8649: "Photoshop",
    0x8769: "Exif",
    0x87AF: "GeoKeyDirectory",
    0x87B0: "GeoDoubleParams",
    0x87B1: "GeoAsciiParams",
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
# TIFF field type -> bytes of one value.
_TYPE_BYTES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4}
_MOST_ENTRIES = 1000  # of one directory; cameras write about 60


class BrokenExifError(ValueError):
    """The EXIF block's offsets or counts are invalid."""


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


def clean_exif(block: bytes) -> tuple[bytes, tuple[str, ...]]:
    """Remove all tags that are not allowed. Returns a block of the same length, and the names of the removed tags.

    Bytes to which no tag leads go too: programs may remove a tag and leave its value. A damaged block is replaced by
    zeros.
    """
    try:
        clean, removed = _rebuild(block)
    except (BrokenExifError, struct.error):
        return bytes(len(block)), ("Exif",)
    if len(clean) > len(block):  # happens if values shared bytes, which they no longer do
        return (bytes(len(block)), (*removed, "Exif")) if removed else (block, ())
    return clean.ljust(len(block), b"\0"), removed


def tag_name(tag: int) -> str:
    """Return the name of a tag for the list of removed metadata."""
    return _NAMES.get(tag, f"Tag{tag:#06x}")


def field_bytes(kind: int, count: int) -> int:
    """Return the size of a field's value in bytes. Raises BrokenExifError for an unknown type."""
    if kind not in _TYPE_BYTES:
        raise BrokenExifError(f"field type {kind}")
    return _TYPE_BYTES[kind] * count


def byte_order(block: bytes) -> str:
    """Return the byte order, `<` or `>`. Raises BrokenExifError where the block has no TIFF header."""
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(bytes(block[:4]))
    if order is None:
        raise BrokenExifError("no TIFF header")
    return order


def _rebuild(block: bytes) -> tuple[bytes, tuple[str, ...]]:
    order = byte_order(block)
    image = _directory(block, order, struct.unpack_from(order + "I", block, 4)[0], _ALLOWED_IMAGE_TAGS | {_EXIF_IFD})
    exif = _Directory()
    fields = []
    for each in image.fields:
        if each.tag == _EXIF_IFD:
            exif = _directory(block, order, struct.unpack(order + "I", each.value)[0], ALLOWED_EXIF_TAGS)
        else:
            fields.append(each)
    removed = image.removed + exif.removed + (["Thumbnail"] if image.next_offset else [])
    return _write_tiff(order, fields, exif.fields), tuple(dict.fromkeys(removed))


def _directory(block: bytes, order: str, offset: int, allowed: set[int]) -> _Directory:
    count = struct.unpack_from(order + "H", block, offset)[0]
    if count > _MOST_ENTRIES:
        raise BrokenExifError(f"{count} entries")
    found, total = _Directory(), 0
    for at in range(offset + 2, offset + 2 + 12 * count, 12):
        tag, kind, number, pointer = struct.unpack_from(order + "HHII", block, at)
        if tag not in allowed:
            found.removed.append(tag_name(tag))
            continue
        size = field_bytes(kind, number)
        start = at + 8 if size <= 4 else pointer
        total += size
        if start + size > len(block) or total > len(block):  # overlapping values could add up to gigabytes
            raise BrokenExifError(f"{tag_name(tag)} ends outside of the block")
        value = bytes(block[start : start + size])
        if tag == _MAKER_NOTE:
            _add_maker_note(found, value)
        else:
            found.fields.append(_Field(tag, kind, number, value))
    end = offset + 2 + 12 * count
    found.next_offset = struct.unpack_from(order + "I", block, end)[0] if end + 4 <= len(block) else 0
    return found


def _add_maker_note(found: _Directory, value: bytes) -> None:
    """Add what stays of a maker note to a directory: the acceleration, if it has one."""
    note = acceleration_note(value)
    if note:
        found.fields.append(_Field(_MAKER_NOTE, _UNDEFINED, len(note), note))
    if note != value:
        found.removed.append(tag_name(_MAKER_NOTE))


def _write_tiff(order: str, image: list[_Field], exif: list[_Field]) -> bytes:
    """Serialise a TIFF structure: one image directory, followed by its Exif directory."""
    header = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(order + "I", 8)
    exif_at = 8 + len(_pack_directory(order, [*image, _pointer(order, 0)], 8))
    if not exif:
        return header + _pack_directory(order, image, 8)
    return (
        header + _pack_directory(order, [*image, _pointer(order, exif_at)], 8) + _pack_directory(order, exif, exif_at)
    )


def _pointer(order: str, offset: int) -> _Field:
    return _Field(_EXIF_IFD, 4, 1, struct.pack(order + "I", offset))


def _pack_directory(order: str, fields: list[_Field], offset: int) -> bytes:
    """Serialise a directory at `offset`, followed by the values that do not fit into its entries."""
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
