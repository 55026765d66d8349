"""Select pictures of a capture for texturing: sharp ones, evenly spread over the camera's path."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from services.edge.arrays import Floats
from services.edge.capture.nouns import Frame
from services.edge.points.nouns import TextureView

MAX_TEXTURE_VIEWS = 40
"""Most pictures: one every 9 degrees of a walk around an object; each further one costs half a second for a texture of
2048 texels."""


def select_texture_views(frames: Sequence[Frame], sharpness: Floats) -> tuple[TextureView, ...]:
    """Select at most `MAX_TEXTURE_VIEWS` of the posed frames with pictures: the sharpest of each part of the capture.

    sharpness (M,) of the frames' pictures: comparable only between pictures of the same surface, such as neighbours.
    """
    pictured = [number for number, frame in enumerate(frames) if frame.load_rgb is not None]
    parts = np.array_split(np.array(pictured, dtype=int), min(MAX_TEXTURE_VIEWS, len(pictured))) if pictured else []
    return tuple(_texture_view(frames[part[sharpness[part].argmax()]]) for part in parts)


def _texture_view(frame: Frame) -> TextureView:
    """Make a texture view from a frame that has a picture and a pose."""
    assert frame.load_rgb is not None
    pose = np.asarray(frame.camera_to_world, np.float64)
    return TextureView(frame.intrinsics, pose, frame.load_rgb, frame.load_depth_m)
