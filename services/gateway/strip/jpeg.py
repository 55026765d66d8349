"""JPEG (ITU T.81): segments that say how to decode stay, Exif is rebuilt, all other metadata becomes zeros."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator

from services.gateway.uploads.cleaned import MOST_PARTS, Buffer, Cleaned, UnreadableError, blank, is_blank, unique
from services.gateway.uploads.exif import cleaned_exif

_SCAN, _END, _COMMENT = 0xDA, 0xD9, 0xFE
_ALONE = {0x01, *range(0xD0, 0xD8)}  # markers without a length: TEM and the restarts
_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
_PROGRESSIVE = {0xC2, 0xC6, 0xCA, 0xCE}
# In entropy-coded data: the first marker that is neither a stuffed zero nor a restart nor a fill byte.
_NEXT_MARKER = re.compile(rb"\xff[\x01-\xcf\xd8-\xfe]")
_EXIF = b"Exif\0\0"
_KEPT = ((0xE0, b"JFIF\0"), (0xE0, b"JFXX\0"), (0xE2, b"ICC_PROFILE\0"), (0xEE, b"Adobe"))
_NAMES = (
    (0xE1, b"http://ns.adobe.com/", "XMP"),
    (0xE2, b"MPF\0", "MultiPicture"),
    (0xED, b"Photoshop", "IPTC"),
    (0xEB, b"JP", "JUMBF"),
    (_COMMENT, b"", "Comment"),
)


def clean(data: Buffer) -> Cleaned:
    """Metadata in place; what lies behind the picture (a second one, a film, a depth map) is cut off."""
    removed: list[str] = []
    end = len(data)  # until the last segment tells where the picture ends
    for marker, start, end in _segments(data):
        if marker == 0xE1 and data[start : start + 6] == _EXIF:
            data[start + 6 : end], names = cleaned_exif(bytes(data[start + 6 : end]))
            removed += names
        elif _is_metadata(data, marker, start) and not is_blank(data, start, end):
            removed.append(_name(data, marker, start))
            blank(data, start, end)
    if end < len(data):
        removed.append("Trailer")
    return Cleaned(unique(removed), end)


def is_progressive(data: Buffer) -> bool:
    """Whether a decoder needs all coefficients in memory at once: six bytes per pixel."""
    return any(marker in _PROGRESSIVE for marker, _, _ in _segments(data))


def _segments(data: Buffer) -> Iterator[tuple[int, int, int]]:
    """(marker, first and end byte of its payload), the end marker last. Raises UnreadableError."""
    at = 2
    for _ in range(MOST_PARTS):
        if at + 2 > len(data):
            break
        marker = data[at + 1]
        if data[at] != 0xFF:
            raise UnreadableError(f"the JPEG has no marker where one must be, at byte {at:,}")
        if marker == _END:
            yield marker, at + 2, at + 2
            return
        if marker == 0xFF:  # a fill byte
            at += 1
        elif marker in _ALONE:
            at += 2
        else:
            end = at + 2 + _length(data, at + 2)
            yield marker, at + 4, end
            at = _next_marker(data, end) if marker == _SCAN else end
    raise UnreadableError("the JPEG is cut short: it has no end marker")


def _length(data: Buffer, at: int) -> int:
    if at + 2 > len(data):
        raise UnreadableError("the JPEG is cut short")
    length = int(struct.unpack_from(">H", data, at)[0])
    if length < 2 or at + length > len(data):
        raise UnreadableError(f"the JPEG is cut short: a segment at byte {at:,} has {length:,} bytes")
    return length


def _next_marker(data: Buffer, at: int) -> int:
    found = _NEXT_MARKER.search(data, at)
    if found is None:
        raise UnreadableError("the JPEG is cut short: its picture does not end")
    return found.start()


def _is_metadata(data: Buffer, marker: int, start: int) -> bool:
    if not (0xE0 <= marker <= 0xEF or marker == _COMMENT):
        return False
    return not any(marker == kept and data[start : start + len(begin)] == begin for kept, begin in _KEPT)


def _name(data: Buffer, marker: int, start: int) -> str:
    for known, begin, name in _NAMES:
        if marker == known and data[start : start + len(begin)] == begin:
            return name
    return f"APP{marker - 0xE0}"
