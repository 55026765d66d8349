"""Read and rebuild the acceleration vector in Apple's EXIF maker note: which way was down when a photo was taken.

A maker note (EXIF tag 0x927C) of an iPhone is "Apple iOS", a version, "MM", and a big-endian TIFF directory whose
offsets count from the note's first byte. Tag 0x0008 has three signed rationals: what Core Motion calls gravity, in g,
along the phone's axes right, top and out of the screen. Held upright they are 0, -1, 0. The note's other tags name
persons, places and times, so that a gateway keeps this one only.
"""

from __future__ import annotations

import struct

_HEAD = b"Apple iOS\0\0\1MM"
_ACCELERATION, _SRATIONAL, _AXES = 0x0008, 10, 3
_MOST_ENTRIES = 200  # iPhones write about 50
_STEPS_PER_G = 10_000  # of the rebuilt values: 0.006 degrees
_LEAST_G, _MOST_G = 0.5, 1.5  # beyond, the phone was thrown or shaken, and the vector says nothing about down


def read_acceleration(note: bytes) -> tuple[float, float, float] | None:
    """Return the acceleration in g along right, top and out of the screen; None where the note has none to believe."""
    if not note.startswith(_HEAD):
        return None
    try:
        values = _rationals(note)
        x, y, z = (top / bottom for top, bottom in zip(values[::2], values[1::2], strict=True))
    except (struct.error, ZeroDivisionError, ValueError):
        return None
    return (x, y, z) if _LEAST_G**2 <= x * x + y * y + z * z <= _MOST_G**2 else None


def acceleration_note(note: bytes) -> bytes:
    """Return a maker note with nothing but the acceleration of `note`; b"" where that has none."""
    found = read_acceleration(note)
    if found is None:
        return b""
    values = [number for each in found for number in (round(each * _STEPS_PER_G), _STEPS_PER_G)]
    start = len(_HEAD) + 2 + 12 + 4
    entry = struct.pack(">HHHIII", 1, _ACCELERATION, _SRATIONAL, _AXES, start, 0)
    return _HEAD + entry + struct.pack(">6i", *values)


def _rationals(note: bytes) -> tuple[int, ...]:
    """Return numerators and denominators of the vector. Raises struct.error and ValueError for a note without it."""
    at = len(_HEAD)
    (count,) = struct.unpack_from(">H", note, at)
    for entry in range(at + 2, at + 2 + 12 * min(count, _MOST_ENTRIES), 12):
        tag, kind, number, offset = struct.unpack_from(">HHII", note, entry)
        if (tag, kind, number) == (_ACCELERATION, _SRATIONAL, _AXES):
            return struct.unpack_from(">6i", note, offset)
    raise ValueError("the note has no acceleration")
