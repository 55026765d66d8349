"""Strip OpenEXR files: overwrite header attributes that identify persons and places with zeros; read the image size."""

from __future__ import annotations

import struct
from collections.abc import Iterator

from capture2vr.gateway.strip.in_place import (
    MOST_PARTS,
    Buffer,
    CleanResult,
    UnreadableError,
    blank,
    is_blank,
    unique_names,
)
from capture2vr.sentences.sentence import say

_REMOVED_ATTRIBUTES = {b"owner", b"comments", b"longitude", b"latitude", b"altitude", b"utcOffset", b"xmp"}
_REMOVED_ATTRIBUTES |= {b"cameraSerialNumber", b"lensSerialNumber", b"cameraUuid", b"cameraLabel"}
# How programs name tags of EXIF and IPTC that they copy from a photo.
_REMOVED_BEGINNINGS = (b"GPS:", b"Exif:", b"IPTC:", b"Artist", b"Copyright", b"ImageDescription", b"HostComputer")
_MULTI_PART = 0x10  # bit of the third byte of the version
_LONGEST_NAME = 256  # 255 bytes and the terminating zero


def clean(data: Buffer) -> CleanResult:
    """Strip the metadata in place. Raises UnreadableError."""
    removed: list[str] = []
    for name, start, stop in _attributes(data):
        if (name in _REMOVED_ATTRIBUTES or name.startswith(_REMOVED_BEGINNINGS)) and not is_blank(data, start, stop):
            blank(data, start, stop)
            removed.append(name.decode("latin-1"))
    return CleanResult(unique_names(removed), len(data))


def size(data: Buffer) -> tuple[int, int]:
    """Return (width, height) in pixels, from the first data window. Raises UnreadableError."""
    for name, start, stop in _attributes(data):
        if name == b"dataWindow" and stop - start == 16:
            x_min, y_min, x_max, y_max = struct.unpack_from("<4i", data, start)
            return x_max - x_min + 1, y_max - y_min + 1
    raise UnreadableError(say("exr_image_has_no_size"))


def _attributes(data: Buffer) -> Iterator[tuple[bytes, int, int]]:
    """Yield (name, first byte, end byte of the value) of each attribute in the headers of all parts."""
    at, first, parts = 8, 8, len(data) > 5 and bool(data[5] & _MULTI_PART)
    for _ in range(MOST_PARTS):
        name, at = _read_string(data, at)
        if not name:
            if not parts or at == first + 1:  # an empty header ends those of several parts
                return
            first = at
            continue
        _, at = _read_string(data, at)  # the type
        if at + 4 > len(data):
            raise UnreadableError(say("exr_image_cut_short"))
        length = struct.unpack_from("<i", data, at)[0]
        if length < 0 or at + 4 + length > len(data):
            raise UnreadableError(say("exr_image_cut_short_within", name=repr(name)))
        yield name, at + 4, at + 4 + length
        at += 4 + length
    raise UnreadableError(say("exr_image_header"))


def _read_string(data: Buffer, at: int) -> tuple[bytes, int]:
    """Read a zero-terminated string; returns it and the offset behind it. Raises UnreadableError."""
    end = data.find(b"\0", at, at + _LONGEST_NAME)
    if end < 0:
        raise UnreadableError(say("exr_image_header_damaged_cut"))
    return bytes(data[at:end]), end + 1
