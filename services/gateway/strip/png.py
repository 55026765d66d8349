"""PNG (W3C, third edition): chunks that say how to decode stay, eXIf is rebuilt, all others become empty shells."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator

from services.gateway.uploads.cleaned import MOST_PARTS, Buffer, Cleaned, UnreadableError, checksum, metadata, unique
from services.gateway.uploads.exif import cleaned_exif

_KEPT = {b"IHDR", b"PLTE", b"IDAT", b"IEND", b"tRNS", b"gAMA", b"cHRM", b"sRGB", b"iCCP", b"cICP", b"mDCV", b"cLLI"}
_KEPT |= {b"sBIT", b"bKGD", b"hIST", b"pHYs", b"acTL", b"fcTL", b"fdAT"}
_SHELL = b"naDa"  # an ancillary, private chunk that nobody knows: every decoder must skip it
_NAMES = {b"tEXt": "Text", b"zTXt": "Text", b"iTXt": "Text", b"tIME": "Time"}
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # by colour type
_INFLATE_BYTES = 1 << 16  # at once: the check of a 100-megapixel picture costs this much memory


def clean(data: Buffer) -> Cleaned:
    """Metadata in place; what lies behind the last chunk is cut off."""
    removed: list[str] = []
    end = len(data)
    for kind, start, stop in _chunks(data):
        end = stop + 4
        if kind == b"eXIf":
            block, names = cleaned_exif(metadata(data, start, stop))
            _rewrite(data, kind, start, block)
            removed += names
        elif kind not in _KEPT and kind != _SHELL:
            _rewrite(data, _SHELL, start, bytes(len(metadata(data, start, stop))))
            removed.append(_NAMES.get(kind, kind.decode("latin-1")))
    if end < len(data):
        removed.append("Trailer")
    return Cleaned(unique(removed), end)


def check_pixels(data: Buffer) -> None:
    """Inflate the picture, without keeping it, and count. Raises UnreadableError when bytes are missing or damaged."""
    inflater, size = zlib.decompressobj(), 0
    expected = _raw_bytes(data)
    try:
        for packed in _pixel_blocks(data):
            while packed and not inflater.eof:
                size += len(inflater.decompress(packed, _INFLATE_BYTES))
                packed = inflater.unconsumed_tail
                if size > 2 * expected + _INFLATE_BYTES:  # filters and interlacing add some bytes per row
                    raise UnreadableError("the PNG holds more pixels than its header says")
    except zlib.error as error:
        raise UnreadableError(f"the PNG's pixels are damaged: {error}") from None
    if size < expected:
        raise UnreadableError(f"the PNG is cut short: {size:,} of {expected:,} bytes of pixels are there")


def _pixel_blocks(data: Buffer) -> Iterator[bytes]:
    for kind, start, stop in _chunks(data):
        if kind == b"IDAT":
            for at in range(start, stop, _INFLATE_BYTES):
                yield bytes(data[at : min(at + _INFLATE_BYTES, stop)])


def _raw_bytes(data: Buffer) -> int:
    """Bytes of the unfiltered rows, at least: of an interlaced picture they are a few more."""
    width, height, depth, colour = struct.unpack_from(">IIBB", data, 16)
    return int(height * ((width * depth * _CHANNELS.get(colour, 1) + 7) // 8))


def _chunks(data: Buffer) -> Iterator[tuple[bytes, int, int]]:
    """(type, first and end byte of its content), IEND last. Raises UnreadableError."""
    at = 8
    for _ in range(MOST_PARTS):
        if at + 12 > len(data):
            break
        length, kind = struct.unpack_from(">I4s", data, at)
        start, stop = at + 8, at + 8 + length
        if stop + 4 > len(data):
            raise UnreadableError(f"the PNG is cut short within its chunk {kind!r}")
        if checksum(data, start - 4, stop) != struct.unpack_from(">I", data, stop)[0]:
            raise UnreadableError(f"the PNG's chunk {kind!r} is damaged: wrong checksum")
        yield kind, start, stop
        if kind == b"IEND":
            return
        at = stop + 4
    raise UnreadableError("the PNG is cut short: it has no end")


def _rewrite(data: Buffer, kind: bytes, start: int, content: bytes) -> None:
    data[start - 4 : start] = kind
    data[start : start + len(content)] = content
    data[start + len(content) : start + len(content) + 4] = struct.pack(">I", zlib.crc32(kind + content))
