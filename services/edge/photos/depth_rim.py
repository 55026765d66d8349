"""The rim that stereo adds around a thing in front of a plain background.

A window at an outline matches as long as some of the thing is in it, so depth reaches half a window beyond the thing,
over what lies behind. Other views confirm it: a plain background looks the same from everywhere. Its colour tells.
"""

from __future__ import annotations

import numpy as np

from services.edge.arrays import Bools, Bytes, Floats
from services.edge.photos.zncc import WINDOW

_REACH = WINDOW // 2 + 1
"""Pixels that the rim is wide: half a window, and one that the smoothing of the disparities adds."""
_AROUND = 4 * _REACH + 1
"""Side of the window that tells how the thing and the background look there."""
_STEP = 0.03
"""Relative difference of depth across an outline; the surface itself changes less within the rim's width."""
_FEWEST = _REACH * _REACH
"""Pixels of either side that tell how it looks."""
_LEAST_SPREAD = 5.0
"""Grey levels, 1 sigma, that noise and compression give to what has one colour."""
_SURE = 6.0
"""Twice the logarithm of how much likelier the background's colour is to be: 1 : 20."""
_OPEN = 0.01
"""Share of the picture from which on what has no depth is background: a patch without texture on the thing is not."""


def without_rim(depth: Floats, rgb: Bytes) -> Floats:
    """The depth image (H,W), 0 where unknown, without what looks (rgb (H,W,3)) like the background at an outline."""
    import cv2

    near = _dilated(np.where(depth > 0, 1 / np.where(depth > 0, depth, 1), 0))
    thing = (depth > 0) & (depth * near < 1 + _STEP)
    beyond = ~thing & _wide(~thing)
    core = cv2.erode(thing.astype(np.uint8), np.ones((2 * _REACH + 1,) * 2, np.uint8), borderValue=1) > 0
    colour = rgb.astype(np.float32)
    unlike_thing, told = _unlikeness(colour, core)
    unlike_beyond, told_too = _unlikeness(colour, beyond)
    rim = thing & ~core & told & told_too & (unlike_thing > unlike_beyond + _SURE)
    return np.where(rim, np.float32(0), depth)


def _dilated(inverse: Floats) -> Floats:
    import cv2

    return np.asarray(cv2.dilate(inverse.astype(np.float32), np.ones((2 * _REACH + 1,) * 2, np.uint8)))


def _wide(mask: Bools) -> Bools:
    """The pieces of a mask (H,W) that are large."""
    import cv2

    count, label, figures, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    large = figures[:count, cv2.CC_STAT_AREA] >= _OPEN * mask.size
    large[0] = False
    return np.asarray(large[label])


def _unlikeness(colour: Floats, which: Bools) -> tuple[Floats, Bools]:
    """(H,W) minus twice the logarithm of the likelihood of each pixel's colour among those of `which` around it, up to
    a constant, by a normal distribution; and where enough of them are."""
    import cv2

    def around(values: Floats) -> Floats:
        return np.asarray(cv2.boxFilter(values, cv2.CV_32F, (_AROUND, _AROUND), normalize=False))

    weight = which.astype(np.float32)
    count = np.maximum(around(weight), 1)
    mean = around(weight[..., None] * colour) / count[..., None]
    square = around(weight * np.einsum("hwc,hwc->hw", colour, colour)) / count
    spread = np.maximum(square - np.einsum("hwc,hwc->hw", mean, mean), 0) / 3 + _LEAST_SPREAD**2
    off = np.einsum("hwc,hwc->hw", colour - mean, colour - mean)
    return off / spread + 3 * np.log(spread), count >= _FEWEST
