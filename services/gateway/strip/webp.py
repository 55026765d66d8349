"""WebP (RFC 9649): the EXIF chunk is rebuilt, XMP and unknown chunks become zeros."""

from __future__ import annotations

import struct

from services.gateway.uploads.cleaned import (
    MOST_PARTS,
    Buffer,
    Cleaned,
    UnreadableError,
    blank,
    is_blank,
    metadata,
    unique,
)
from services.gateway.uploads.exif import cleaned_exif

_KEPT = {b"VP8 ", b"VP8L", b"VP8X", b"ALPH", b"ANIM", b"ANMF", b"ICCP"}


def clean(data: Buffer) -> Cleaned:
    """Metadata in place; what lies behind the RIFF container is cut off. Raises UnreadableError."""
    end = 8 + struct.unpack_from("<I", data, 4)[0]
    if end > len(data):
        raise UnreadableError(f"the WebP is cut short: {len(data):,} of {end:,} bytes are there")
    removed: list[str] = []
    at = 12
    for _ in range(MOST_PARTS):
        if at + 8 > end:
            break
        kind, length = struct.unpack_from("<4sI", data, at)
        start, stop = at + 8, at + 8 + length
        if stop > end:
            raise UnreadableError(f"the WebP's chunk {kind!r} ends outside of the file")
        if kind == b"EXIF":
            removed += _clean_exif(data, start, stop)
        elif kind not in _KEPT and not is_blank(data, start, stop):
            blank(data, start, stop)
            removed.append(kind.decode("latin-1").strip())
        at = stop + length % 2
    if end < len(data):
        removed.append("Trailer")
    return Cleaned(unique(removed), end)


def _clean_exif(data: Buffer, start: int, stop: int) -> tuple[str, ...]:
    if data[start : start + 6] == b"Exif\0\0":  # some writers keep JPEG's prefix
        start += 6
    data[start:stop], removed = cleaned_exif(metadata(data, start, stop))
    return removed
