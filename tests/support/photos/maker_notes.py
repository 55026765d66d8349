"""Maker notes as iPhones write them into EXIF: some tags about the picture, some about its owner, and gravity."""

from __future__ import annotations

import struct
from collections.abc import Sequence

SECRET = b"6F9619FF-8B86-D011-B42D-00CF4FC964FF"
"""What an iPhone calls the content's id: the same in a live photo's film."""


def apple_note(
    down: Sequence[float], *, secret: bytes = SECRET, denominators: Sequence[int] = (65535, 32767, 99991)
) -> bytes:
    """A maker note with a version, the acceleration `down` in g (right, top, out of the screen), and an id."""
    head = b"Apple iOS\0\0\1MM"
    values = [number for g, below in zip(down, denominators, strict=True) for number in (round(g * below), below)]
    start = len(head) + 2 + 3 * 12 + 4
    entries = [
        struct.pack(">HHIi", 0x0001, 9, 1, 14),
        struct.pack(">HHII", 0x0008, 10, 3, start),
        struct.pack(">HHII", 0x0011, 2, len(secret), start + 24),
    ]
    return head + struct.pack(">H", 3) + b"".join(entries) + bytes(4) + struct.pack(">6i", *values) + secret
