"""Strip WebP files (RFC 9649): rebuild the EXIF chunk, overwrite XMP and unknown chunks with zeros."""

from __future__ import annotations

import struct

from capture2vr.gateway.strip.exif import clean_exif
from capture2vr.gateway.strip.in_place import (
    MOST_PARTS,
    Buffer,
    CleanResult,
    UnreadableError,
    blank,
    is_blank,
    read_metadata,
    unique_names,
)
from capture2vr.sentences.sentence import say

_ALLOWED_IN_FRAME = {b"VP8 ", b"VP8L", b"ALPH"}
_ALLOWED_CHUNKS = _ALLOWED_IN_FRAME | {b"VP8X", b"ANIM", b"ANMF", b"ICCP", b"EXIF"}
_FRAME_HEADER = 16  # bytes of a frame of an animation before its chunks


def clean(data: Buffer) -> CleanResult:
    """Strip the metadata in place. Data behind the RIFF container are to be cut off. Raises UnreadableError."""
    end = 8 + struct.unpack_from("<I", data, 4)[0]
    if end > len(data):
        raise UnreadableError(say("webp_cut_short_has_bytes", size=len(data), end=end))
    removed = _clean_chunks(data, 12, end, _ALLOWED_CHUNKS)
    if end < len(data):
        removed.append("Trailer")
    return CleanResult(unique_names(removed), end)


def _clean_chunks(data: Buffer, at: int, end: int, allowed: set[bytes]) -> list[str]:
    """Strip consecutive chunks, and those in the frames of an animation; return the names of what was removed."""
    removed: list[str] = []
    for _ in range(MOST_PARTS):
        if at + 8 > end:
            break
        kind, length = struct.unpack_from("<4sI", data, at)
        start, stop = at + 8, at + 8 + length
        if stop > end:
            raise UnreadableError(say("webp_chunk_ends_outside_file", kind=repr(kind)))
        if kind == b"EXIF" and kind in allowed:
            removed += _clean_exif(data, start, stop)
        elif kind == b"ANMF" and kind in allowed:
            removed += _clean_chunks(data, start + _FRAME_HEADER, stop, _ALLOWED_IN_FRAME)
        elif kind not in allowed and not is_blank(data, start, stop):
            blank(data, start, stop)
            removed.append(kind.decode("latin-1").strip())
        at = stop + length % 2
    return removed


def _clean_exif(data: Buffer, start: int, stop: int) -> tuple[str, ...]:
    if data[start : start + 6] == b"Exif\0\0":  # some programs write JPEG's prefix here too
        start += 6
    data[start:stop], removed = clean_exif(read_metadata(data, start, stop))
    return removed
