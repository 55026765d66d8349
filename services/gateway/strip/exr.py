"""OpenEXR: the header's attributes of person and place become zeros; its size is read from the data window."""

from __future__ import annotations

import struct
from collections.abc import Iterator

from services.gateway.uploads.cleaned import MOST_PARTS, Buffer, Cleaned, UnreadableError, blank, is_blank, unique

_REMOVED = {b"owner", b"comments", b"longitude", b"latitude", b"altitude", b"utcOffset", b"cameraSerialNumber"}
_REMOVED |= {b"lensSerialNumber", b"cameraUuid", b"cameraLabel", b"xmp"}
_LONGEST_NAME = 256  # 255 bytes and the zero


def clean(data: Buffer) -> Cleaned:
    """Metadata in place. Raises UnreadableError."""
    removed: list[str] = []
    for name, start, stop in _attributes(data):
        if name in _REMOVED and not is_blank(data, start, stop):
            blank(data, start, stop)
            removed.append(name.decode())
    return Cleaned(unique(removed), len(data))


def size(data: Buffer) -> tuple[int, int]:
    """(width, height). Raises UnreadableError."""
    for name, start, stop in _attributes(data):
        if name == b"dataWindow" and stop - start == 16:
            left, top, right, bottom = struct.unpack_from("<4i", data, start)
            return right - left + 1, bottom - top + 1
    raise UnreadableError("the EXR does not say how big it is")


def _attributes(data: Buffer) -> Iterator[tuple[bytes, int, int]]:
    """(name, first and end byte of the value) of the first part's header."""
    at = 8
    for _ in range(MOST_PARTS):
        name, at = _word(data, at)
        if not name:
            return
        _, at = _word(data, at)  # the type
        if at + 4 > len(data):
            raise UnreadableError("the EXR is cut short")
        length = struct.unpack_from("<i", data, at)[0]
        if length < 0 or at + 4 + length > len(data):
            raise UnreadableError(f"the EXR is cut short within its attribute {name!r}")
        yield name, at + 4, at + 4 + length
        at += 4 + length
    raise UnreadableError("the EXR's header does not end")


def _word(data: Buffer, at: int) -> tuple[bytes, int]:
    end = data.find(b"\0", at, at + _LONGEST_NAME)
    if end < 0:
        raise UnreadableError("the EXR's header is damaged or cut short")
    return bytes(data[at:end]), end + 1
