"""A few of a capture's pictures, for textures: sharp ones from all along its way."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from services.edge.arrays import Floats
from services.edge.capture.nouns import Frame
from services.edge.points.nouns import Shot

MOST_SHOTS = 40
"""Of a walk around a thing one every 9 degrees; each more takes half a second of a texture of 2048 texels."""


def sharpest(frames: Sequence[Frame], sharpness: Floats) -> tuple[Shot, ...]:
    """At most `MOST_SHOTS` of the posed frames that have pictures: the sharpest of each part of the capture.

    sharpness (M,) of the frames' pictures: only those of the same surface compare, which neighbours show.
    """
    pictured = [number for number, frame in enumerate(frames) if frame.load_rgb is not None]
    parts = np.array_split(np.array(pictured, dtype=int), min(MOST_SHOTS, len(pictured))) if pictured else []
    return tuple(_shot(frames[part[sharpness[part].argmax()]]) for part in parts)


def _shot(frame: Frame) -> Shot:
    assert frame.load_rgb is not None
    pose = np.asarray(frame.camera_to_world, np.float64)
    return Shot(frame.intrinsics, pose, frame.load_rgb, frame.load_depth_m)
