"""Strip JPEG files (ITU T.81): keep segments needed to decode, rebuild Exif, overwrite other metadata with zeros."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator

from capture2vr.gateway.strip.exif import clean_exif
from capture2vr.gateway.strip.in_place import (
    MOST_PARTS,
    Buffer,
    CleanResult,
    UnreadableError,
    blank,
    is_blank,
    unique_names,
)
from capture2vr.gateway.strip.panorama_tags import projection_of_picture
from capture2vr.sentences.sentence import say

_SCAN, _END, _COMMENT = 0xDA, 0xD9, 0xFE
_WITHOUT_LENGTH = {0x01, *range(0xD0, 0xD8)}  # markers without a length: TEM and the restarts
_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
_PROGRESSIVE = {0xC2, 0xC6, 0xCA, 0xCE}
# In entropy-coded data: the first marker that is neither a stuffed zero nor a restart nor a fill byte.
_NEXT_MARKER = re.compile(rb"\xff[\x01-\xcf\xd8-\xfe]")
_EXIF = b"Exif\0\0"
_ALLOWED_SEGMENTS = ((0xE0, b"JFIF\0"), (0xE0, b"JFXX\0"), (0xE2, b"ICC_PROFILE\0"), (0xEE, b"Adobe"))
_NAMES = (
    (0xE1, _EXIF, "Exif"),
    (0xE1, b"http://ns.adobe.com/", "XMP"),
    (0xE2, b"MPF\0", "MultiPicture"),
    (0xED, b"Photoshop", "IPTC"),
    (0xEB, b"JP", "JUMBF"),
    (_COMMENT, b"", "Comment"),
)


def clean(data: Buffer) -> CleanResult:
    """Strip the metadata in place. Data behind the image (a second image, a video, a depth map) are to be cut off.

    Raises UnreadableError.
    """
    removed: list[str] = []
    has_exif = False  # a second block says nothing that a reader needs, and decoders join them all, in quadratic time
    end = len(data)  # replaced by the end of the last segment
    for marker, start, end in _segments(data):
        if not has_exif and marker == 0xE1 and data[start : start + 6] == _EXIF:
            data[start + 6 : end], names = clean_exif(bytes(data[start + 6 : end]))
            has_exif = True
            removed += names
        elif _is_metadata(data, marker, start) and not is_blank(data, start, end):
            removed += _blanked(data, marker, start, end)
    if end < len(data):
        removed.append("Trailer")
    return CleanResult(unique_names(removed), end)


def _blanked(data: Buffer, marker: int, start: int, end: int) -> list[str]:
    """Overwrite metadata, but for the projection of a panorama; return its name where it was more than that."""
    block, name = bytes(data[start:end]), _name(data, marker, start)
    kept = projection_of_picture(block) if marker == 0xE1 else b""
    if kept == block:
        return []
    if kept:
        data[start:end] = kept
    else:
        blank(data, start, end)
    return [name]


def is_progressive(data: Buffer) -> bool:
    """Return whether the JPEG is progressive: its decoder needs all coefficients in memory, six bytes per pixel."""
    return any(marker in _PROGRESSIVE for marker, _, _ in _segments(data))


def count_scans(data: Buffer) -> int:
    """Return the number of scans: a progressive JPEG may have many, and its decoder visits all pixels in each."""
    return sum(marker == _SCAN for marker, _, _ in _segments(data))


def _segments(data: Buffer) -> Iterator[tuple[int, int, int]]:
    """Yield (marker, first and end byte of payload) of each segment, the end marker last. Raises UnreadableError."""
    at = 2
    for _ in range(MOST_PARTS):
        if at + 2 > len(data):
            break
        marker = data[at + 1]
        if data[at] != 0xFF:
            raise UnreadableError(say("jpeg_damaged_marker_missing_byte", at=at))
        if marker == _END:
            yield marker, at + 2, at + 2
            return
        if marker == 0xFF:  # a fill byte
            at += 1
        elif marker in _WITHOUT_LENGTH:
            at += 2
        else:
            end = at + 2 + _length(data, at + 2)
            yield marker, at + 4, end
            at = _next_marker(data, end) if marker == _SCAN else end
    raise UnreadableError(say("jpeg_has_no_end_marker"))


def _length(data: Buffer, at: int) -> int:
    if at + 2 > len(data):
        raise UnreadableError(say("jpeg_cut_short"))
    length = int(struct.unpack_from(">H", data, at)[0])
    if length < 2 or at + length > len(data):
        raise UnreadableError(say("jpeg_cut_short_segment_byte", at=at, length=length))
    return length


def _next_marker(data: Buffer, at: int) -> int:
    found = _NEXT_MARKER.search(data, at)
    if found is None:
        raise UnreadableError(say("jpeg_cut_short_image_data"))
    return found.start()


def _is_metadata(data: Buffer, marker: int, start: int) -> bool:
    if not (0xE0 <= marker <= 0xEF or marker == _COMMENT):
        return False
    return not any(
        marker == allowed and data[start : start + len(begin)] == begin for allowed, begin in _ALLOWED_SEGMENTS
    )


def _name(data: Buffer, marker: int, start: int) -> str:
    for code, begin, name in _NAMES:
        if marker == code and data[start : start + len(begin)] == begin:
            return name
    return f"APP{marker - 0xE0}"
