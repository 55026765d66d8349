"""Select pictures of a capture: for texturing, and to hold out, so that the result can be compared with them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.nouns import Frame
from capture2vr.edge.points.nouns import TextureView

MAX_TEXTURE_VIEWS = 40
"""Most pictures: one every 9 degrees of a walk around an object; each further one costs half a second for a texture of
2048 texels."""

_TURN_DEG, _SHIFT_M = 10.0, 0.25
"""Of the camera, within which the pictures of a walk show the same: the sharpest of them is enough."""

HOLD_OUT_FROM = 16
"""Least number of posed pictures of which some are held out; fewer need each other."""
_ONE_IN, _MOST_HELD_OUT = 8, 4
"""One picture in so many is held out, and at most so many: each takes a third of a second to compare."""


def hold_out_frames(frames: Sequence[Frame], count: int | None = None) -> tuple[tuple[Frame, ...], tuple[Frame, ...]]:
    """Split posed frames into those to reconstruct from, and pictures evenly spread over the path to compare with.

    count: number of pictures to hold out; None: one in eight, at most four, none of fewer than `HOLD_OUT_FROM`.
    """
    pictured = [number for number, frame in enumerate(frames) if frame.load_rgb is not None]
    if count is None:
        count = min(len(pictured) // _ONE_IN, _MOST_HELD_OUT) if len(pictured) >= HOLD_OUT_FROM else 0
    chosen = {pictured[int((place + 0.5) * len(pictured) / count)] for place in range(min(count, len(pictured)))}
    kept = tuple(frame for number, frame in enumerate(frames) if number not in chosen)
    return kept, tuple(frames[number] for number in sorted(chosen))


def select_texture_views(frames: Sequence[Frame], sharpness: Floats) -> tuple[TextureView, ...]:
    """Select at most `MAX_TEXTURE_VIEWS` of the posed frames with pictures: the sharpest of each part of the capture.

    sharpness (M,) of the frames' pictures: comparable only between pictures of the same surface, such as neighbours.
    """
    pictured = [number for number, frame in enumerate(frames) if frame.load_rgb is not None]
    parts = np.array_split(np.array(pictured, dtype=int), min(MAX_TEXTURE_VIEWS, len(pictured))) if pictured else []
    return tuple(texture_view(frames[part[sharpness[part].argmax()]]) for part in parts)


def select_scene_views(frames: Sequence[Frame], sharpness: Floats) -> tuple[TextureView, ...]:
    """Select pictures all along a walk through a scene: the sharpest of each few steps, without a limit.

    sharpness (M,) as in `select_texture_views`.
    """
    chosen: list[int] = []
    first: Floats | None = None
    for number, frame in enumerate(frames):
        if frame.load_rgb is None:
            continue
        pose = np.asarray(frame.camera_to_world, np.float64)
        if first is None or _is_elsewhere(first, pose):
            first = pose
            chosen.append(number)
        elif sharpness[number] > sharpness[chosen[-1]]:
            chosen[-1] = number
    return tuple(texture_view(frames[number]) for number in chosen)


def _is_elsewhere(first: Floats, pose: Floats) -> bool:
    """Return whether a camera (4,4) has moved or turned so far from another that it shows something else."""
    turned = np.arccos(np.clip((np.trace(first[:3, :3].T @ pose[:3, :3]) - 1) / 2, -1, 1))
    return bool(np.degrees(turned) > _TURN_DEG or np.linalg.norm(pose[:3, 3] - first[:3, 3]) > _SHIFT_M)


def texture_view(frame: Frame) -> TextureView:
    """Make a texture view from a frame that has a picture and a pose."""
    assert frame.load_rgb is not None
    pose = np.asarray(frame.camera_to_world, np.float64)
    return TextureView(
        frame.intrinsics,
        pose,
        frame.load_rgb,
        frame.load_depth_m,
        frame.name,
        tracked=frame.window_px == 1,
        load_mask=frame.load_mask,
    )
