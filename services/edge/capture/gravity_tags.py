"""Read from a photo's EXIF tags how the camera was held against gravity: Apple's acceleration, or EXIF's elevation."""

from __future__ import annotations

import math
from typing import Any

from capture2vr.order.apple_maker_note import read_acceleration

_MAKER_NOTE, _ELEVATION = 0x927C, 0x9405  # Apple's acceleration is in the first; the second is CameraElevationAngle
_UPRIGHT = ((0, -1), (-1, 0), (0, 1), (1, 0))
"""Direction (x, y) of the stored picture that is up after so many clockwise quarter turns."""
_FLAT = 0.5
"""Length of the upward direction within the picture below which the camera looks so steeply up or down that the
picture's own orientation says nothing."""

Direction = tuple[float, float, float]


def up_in_camera(tags: dict[int, Any], turns: int) -> Direction | None:
    """Return the unit vector against gravity in the axes (OpenCV) of the stored picture, from an iPhone's maker note.

    turns  of the picture, as in `Photo`

    The main camera's picture is stored as the sensor reads it: its right is the phone's bottom, and its top the phone's
    right. None without the note, and where the picture's orientation contradicts it: then its pixels were rotated.
    """
    note = tags.get(_MAKER_NOTE)
    down = read_acceleration(note) if isinstance(note, bytes) else None
    if down is None:
        return None
    right, top, out = down  # gravity along the phone's axes, so up is their opposite
    x, y, z = top, right, out
    flat, (up_x, up_y) = math.hypot(x, y), _UPRIGHT[turns]
    length = math.hypot(flat, z)
    if flat > _FLAT * length and x * up_x + y * up_y < flat / 2:
        return None
    return x / length, y / length, z / length


def elevation_deg(tags: dict[int, Any]) -> float | None:
    """Return the elevation of the optical axis over the horizon in degrees, -90 to 90; None where it is not told."""
    try:
        angle = float(tags[_ELEVATION])
    except (KeyError, TypeError, ValueError, ArithmeticError):
        return None
    return angle if -90 <= angle <= 90 else None
