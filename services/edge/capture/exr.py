"""Read OpenEXR pictures, as depth or as colours: of one part, in lines, without compression or with ZIP or RLE.

Written here, because OpenCV's wheel has no decoder of it. Every count in the header is checked against the bytes that
are there before anything is allocated (https://openexr.com/en/latest/OpenEXRFileLayout.html).
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.capture.depth import zero_invalid_depth
from capture2vr.edge.capture.images import broken_image, check_pixels, read_bytes
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.srgb import to_srgb
from capture2vr.sentences.sentence import say

EXR_MAGIC = b"v/1\x01"
_OTHER_KINDS = 0x1A00  # bits of the version: tiles, deep data, several parts
_TYPES = ("<u4", "<f2", "<f4")
_RLE = 1
_LINES = {0: 1, _RLE: 1, 2: 1, 3: 16}  # compression -> lines of a block: none, RLE, ZIPS, ZIP
_COMPRESSIONS = ("none", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "B44", "B44A", "DWAA", "DWAB")
_CHANNELS = ("R", "Z", "Y", "V", "A")  # where programs write depth, most usual first
_COLOURS = ("R", "G", "B")
_MOST_ATTRIBUTES, _MOST_CHANNELS, _MOST_HEADER = 200, 64, 2**16


@dataclass(frozen=True, slots=True)
class _ExrHeader:
    """What a picture's header says. line: type of a line of pixels; start: byte behind the header"""

    size: tuple[int, int]
    top: int
    compression: int
    line: np.dtype[Any]
    start: int


@dataclass(frozen=True, slots=True)
class ExrDepth:
    """Depth image in metres in a channel of an OpenEXR file: a `DepthSource`."""

    path: Path
    file: str

    def size(self) -> tuple[int, int]:
        with self.path.open("rb") as stream:
            return _header(stream.read(_MOST_HEADER), self.file).size

    def load(self) -> Floats:
        return zero_invalid_depth(decode_exr(read_bytes(self.path, self.file), self.file))


def decode_exr(data: bytes, file: str) -> Floats:
    """Decode the first of the usual channels to (H,W) float32. Raises IMAGE_UNREADABLE and IMAGE_TOO_LARGE."""
    head = _header(data, file)
    names = head.line.names or ("",)
    channel = next((name for name in _CHANNELS if name in names), names[0])
    pixels = np.zeros(head.size[::-1], np.float32)
    for row, block in _blocks(data, head, file):
        pixels[row : row + len(block)] = block[channel]
    return pixels


def exr_size(data: bytes, file: str) -> tuple[int, int]:
    """Return (width, height) from a header. Raises IMAGE_UNREADABLE and IMAGE_TOO_LARGE."""
    return _header(data, file).size


def decode_exr_colours(data: bytes, file: str) -> Bytes:
    """Decode R, G and B, which are linear light, to (H,W,3) uint8 sRGB; the first of the other channels as grey.

    Light above 1, a lamp or the sun in a picture of high range, is white. Raises as `decode_exr`.
    """
    head = _header(data, file)
    names = head.line.names or ("",)
    grey = "Y" if "Y" in names else names[0]
    channels = _COLOURS if all(name in names for name in _COLOURS) else (grey,)
    pixels = np.zeros((*head.size[::-1], 3), np.uint8)
    for row, block in _blocks(data, head, file):
        light = np.stack([block[name].astype(np.float32) for name in channels], axis=-1)
        pixels[row : row + len(block)] = to_srgb(np.nan_to_num(light, nan=0.0, posinf=1.0, neginf=0.0))
    return pixels


def _blocks(data: bytes, head: _ExrHeader, file: str) -> Iterator[tuple[int, NDArray[Any]]]:
    """Yield the blocks of lines: the row of the first, and the lines of all channels."""
    height, lines = head.size[1], _LINES[head.compression]
    blocks = -(-height // lines)
    at = head.start + 8 * blocks  # behind the table of the blocks' places, which follow one another
    if at + 8 * blocks > len(data):
        raise broken_image(file, say("exr_cut_off"))
    for _ in range(blocks):
        if at + 8 > len(data):
            raise broken_image(file, say("exr_cut_off"))
        y, packed = struct.unpack_from("<2i", data, at)
        row = y - head.top
        if not 0 <= row < height or not 0 <= packed <= len(data) - at - 8:
            raise broken_image(file, say("exr_cut_off"))
        count = min(lines, height - row)
        block = _unpacked(data[at + 8 : at + 8 + packed], count * head.line.itemsize, head.compression, file)
        yield row, np.frombuffer(block, head.line, count)
        at += 8 + packed


def _unpacked(packed: bytes, size: int, compression: int, file: str) -> bytes:
    """Return a block's bytes; one that is not smaller when it is compressed is stored as it is."""
    if len(packed) >= size:
        return packed[:size]
    try:
        raw = _repeated(packed, size) if compression == _RLE else zlib.decompressobj().decompress(packed, size)
    except zlib.error as error:
        raise broken_image(file, say("exr_block_damaged", why=error)) from None
    if len(raw) != size:
        raise broken_image(file, say("exr_cut_off"))
    steps = np.frombuffer(raw, np.uint8).copy()
    steps[1:] -= 128  # each byte is the difference to the one before, and bytes of even places come first
    halves = np.cumsum(steps, dtype=np.uint8)
    plain = np.empty(size, np.uint8)
    plain[0::2], plain[1::2] = halves[: (size + 1) // 2], halves[(size + 1) // 2 :]
    return plain.tobytes()


def _repeated(packed: bytes, size: int) -> bytes:
    """Undo RLE: behind a negative number as many bytes as they are, behind another one a byte once more than that."""
    raw, at = bytearray(), 0
    while at < len(packed) and len(raw) <= size:
        count = packed[at]
        literal = 256 - count if count > 127 else 0
        raw += packed[at + 1 : at + 1 + literal] if literal else packed[at + 1 : at + 2] * (count + 1)
        at += 1 + (literal or 1)
    return bytes(raw)


def _header(data: bytes, file: str) -> _ExrHeader:
    """Read a header. Raises IMAGE_UNREADABLE for what is not read, by its name, and IMAGE_TOO_LARGE."""
    if data[:4] != EXR_MAGIC or len(data) < 8:
        raise broken_image(file, say("not_exr_image"))
    try:
        found, start = _attributes(data)
        left, top, right, bottom = struct.unpack("<4i", found["dataWindow"])
        size = check_pixels((right - left + 1, bottom - top + 1), file)
        compression, line = found["compression"][0], _line(found["channels"], size[0])
    except (ValueError, KeyError, IndexError, struct.error):
        raise broken_image(file, say("exr_cut_off")) from None
    (version,) = struct.unpack_from("<I", data, 4)
    if version & _OTHER_KINDS or compression not in _LINES:
        kind = _COMPRESSIONS[compression] if compression < len(_COMPRESSIONS) else str(compression)
        what = say("exr_image_of_kind", kind="tiles or parts" if version & _OTHER_KINDS else kind)
        raise CaptureError("IMAGE_UNREADABLE", what, file=file, hints=(say("export_exr_otherwise"),))
    return _ExrHeader(size, top, compression, line, start)


def _attributes(data: bytes) -> tuple[dict[str, bytes], int]:
    """Return a header's attributes by name, and the offset behind them. Raises ValueError and struct.error."""
    found: dict[str, bytes] = {}
    at = 8
    for _ in range(_MOST_ATTRIBUTES):
        end = data.index(b"\0", at)
        if end == at:
            return found, at + 1
        kind_end = data.index(b"\0", end + 1)
        (size,) = struct.unpack_from("<i", data, kind_end + 1)
        if not 0 <= size <= len(data) - kind_end - 5:
            break
        found[data[at:end].decode("latin-1")] = data[kind_end + 5 : kind_end + 5 + size]
        at = kind_end + 5 + size
    raise ValueError("no end of the header")


def _line(channels: bytes, width: int) -> np.dtype[Any]:
    """Return the type of a line: all values of one channel after those of another. Raises ValueError, IndexError."""
    fields: list[tuple[str, str, tuple[int]]] = []
    at = 0
    while channels[at] and len(fields) < _MOST_CHANNELS:
        end = channels.index(b"\0", at)
        kind, _, across, down = struct.unpack_from("<4i", channels, end + 1)
        if (across, down) != (1, 1):
            raise ValueError("a channel of fewer pixels")
        fields.append((channels[at:end].decode("latin-1"), _TYPES[kind], (width,)))
        at = end + 17
    if not fields:
        raise ValueError("no channels")
    return np.dtype(fields)
