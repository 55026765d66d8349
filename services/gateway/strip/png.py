"""Strip PNG files (W3C, third edition): keep chunks needed to decode, rebuild eXIf, blank all other chunks."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator

from capture2vr.gateway.strip.exif import clean_exif
from capture2vr.gateway.strip.in_place import (
    MOST_PARTS,
    Buffer,
    CleanResult,
    UnreadableError,
    blank,
    checksum,
    is_blank,
    read_metadata,
    unique_names,
)
from capture2vr.sentences.sentence import say

_ALLOWED_CHUNKS = {b"IHDR", b"PLTE", b"IDAT", b"IEND", b"tRNS", b"gAMA", b"cHRM", b"sRGB", b"iCCP", b"cICP"}
_ALLOWED_CHUNKS |= {b"mDCV", b"cLLI", b"sBIT", b"bKGD", b"hIST", b"pHYs", b"acTL", b"fcTL", b"fdAT"}
_BLANK_CHUNK = b"naDa"  # an unknown ancillary, private chunk type, which every decoder must skip
_NAMES = {b"tEXt": "Text", b"zTXt": "Text", b"iTXt": "Text", b"tIME": "Time"}
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # by colour type
_INFLATE_BYTES = 1 << 16  # per step: checking a 100-megapixel image costs this much memory


def clean(data: Buffer) -> CleanResult:
    """Strip the metadata in place. Data behind the last chunk are to be cut off. Raises UnreadableError."""
    removed: list[str] = []
    end = len(data)
    for kind, start, stop in _chunks(data):
        end = stop + 4
        if kind == b"eXIf":
            block, names = clean_exif(read_metadata(data, start, stop))
            data[start:stop] = block
            _write_checksum(data, start, stop)
            removed += names
        elif kind not in _ALLOWED_CHUNKS and not (kind == _BLANK_CHUNK and is_blank(data, start, stop)):
            blank(data, start, stop)
            data[start - 4 : start] = _BLANK_CHUNK
            _write_checksum(data, start, stop)
            removed.append(_NAMES.get(kind, kind.decode("latin-1")))
    if end < len(data):
        removed.append("Trailer")
    return CleanResult(unique_names(removed), end)


def check_pixels(data: Buffer) -> None:
    """Inflate the image block by block and count its bytes. Raises UnreadableError if some are missing or damaged."""
    inflater, size = zlib.decompressobj(), 0
    expected = raw_bytes(data)
    try:
        for packed in _pixel_blocks(data):
            while packed and not inflater.eof:
                size += len(inflater.decompress(packed, _INFLATE_BYTES))
                packed = inflater.unconsumed_tail
                if size > 2 * expected + _INFLATE_BYTES:  # filters and interlacing add some bytes per row
                    raise UnreadableError(say("png_has_more_pixels_than"))
    except zlib.error as error:
        raise UnreadableError(say("png_pixels_damaged", error=error)) from None
    if size < expected:
        raise UnreadableError(say("png_cut_short_has_bytes", size=size, expected=expected))


def _pixel_blocks(data: Buffer) -> Iterator[bytes]:
    for kind, start, stop in _chunks(data):
        if kind == b"IDAT":
            for at in range(start, stop, _INFLATE_BYTES):
                yield bytes(data[at : min(at + _INFLATE_BYTES, stop)])


def raw_bytes(data: Buffer) -> int:
    """Return the least number of bytes of the unfiltered rows; an interlaced image has a few more."""
    width, height, depth, colour = struct.unpack_from(">IIBB", data, 16)
    return int(height * ((width * depth * _CHANNELS.get(colour, 1) + 7) // 8))


def _chunks(data: Buffer) -> Iterator[tuple[bytes, int, int]]:
    """Yield (type, first byte, end byte of its content) of each chunk, IEND last. Raises UnreadableError."""
    at = 8
    for _ in range(MOST_PARTS):
        if at + 12 > len(data):
            break
        length, kind = struct.unpack_from(">I4s", data, at)
        start, stop = at + 8, at + 8 + length
        if stop + 4 > len(data):
            raise UnreadableError(say("png_cut_short_within_chunk", kind=repr(kind)))
        if checksum(data, start - 4, stop) != struct.unpack_from(">I", data, stop)[0]:
            raise UnreadableError(say("png_chunk_damaged_wrong_checksum", kind=repr(kind)))
        yield kind, start, stop
        if kind == b"IEND":
            return
        at = stop + 4
    raise UnreadableError(say("png_cut_short"))


def _write_checksum(data: Buffer, start: int, stop: int) -> None:
    struct.pack_into(">I", data, stop, checksum(data, start - 4, stop))
