"""OpenEXR pictures, written by the format's description."""

from __future__ import annotations

import struct
import zlib
from itertools import groupby, pairwise

import numpy as np

KINDS = {"<u4": 0, "<f2": 1, "<f4": 2}


def exr(
    channels: dict[str, np.ndarray], compression: int = 3, *, top: int = 0, turned: bool = False, version: int = 2
) -> bytes:
    """An OpenEXR picture in lines. compression: 0 none, 1 RLE, 2 ZIPS, 3 ZIP; turned: the last block comes first"""
    height, width = next(iter(channels.values())).shape
    listed = b"".join(
        name.encode() + b"\0" + struct.pack("<4i", KINDS[pixels.dtype.str], 0, 1, 1)
        for name, pixels in sorted(channels.items())
    )
    window = struct.pack("<4i", 0, top, width - 1, top + height - 1)
    head = b"v/1\x01" + struct.pack("<I", version)
    for name, kind, value in (
        ("channels", "chlist", listed + b"\0"),
        ("compression", "compression", bytes([compression])),
        ("dataWindow", "box2i", window),
        ("lineOrder", "lineOrder", bytes([int(turned)])),
    ):
        head += name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value
    head += b"\0"
    lines = 16 if compression == 3 else 1
    blocks = []
    for start in range(0, height, lines):
        raw = b"".join(
            pixels[row].tobytes()
            for row in range(start, min(start + lines, height))
            for _, pixels in sorted(channels.items())
        )
        packed = raw if compression == 0 else _packed(raw, compression)
        blocks.append(struct.pack("<2i", top + start, len(packed)) + packed)
    return head + bytes(8 * len(blocks)) + b"".join(reversed(blocks) if turned else blocks)


def _packed(raw: bytes, compression: int) -> bytes:
    """Bytes of even places, then of odd ones; of each its difference to the one before, and 128; then zlib or RLE."""
    mixed = raw[0::2] + raw[1::2]
    steps = bytes([mixed[0], *((b - a + 128) % 256 for a, b in pairwise(mixed))])
    packed = _run_lengths(steps) if compression == 1 else zlib.compress(steps)
    return packed if len(packed) < len(raw) else raw


def _run_lengths(raw: bytes) -> bytes:
    """Runs of at least three equal bytes as their number less one and the byte; others behind their number below 0."""
    packed, literal = b"", b""
    for byte, run in groupby(raw):
        count = len(list(run))
        while count:
            some = min(count, 128)
            if some < 3:
                literal += bytes([byte]) * some
            if literal and (some >= 3 or len(literal) > 120):
                packed, literal = packed + bytes([256 - len(literal)]) + literal, b""
            if some >= 3:
                packed += bytes([some - 1, byte])
            count -= some
    return packed + (bytes([256 - len(literal)]) + literal if literal else b"")
