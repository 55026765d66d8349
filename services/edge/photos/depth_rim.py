"""Remove the rim of false depth that stereo adds around an object in front of a plain background (edge fattening).

A window at an outline matches as long as part of the object is in it, so the object's depth extends half a window over
the background. Other views confirm it, since a plain background looks the same from everywhere; but its colour is that
of the background.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats
from capture2vr.edge.photos.zncc import WINDOW

_REACH = WINDOW // 2 + 1
"""Width of the rim in pixels: half a window, and one that the smoothing of the disparities adds."""
_AROUND = 4 * _REACH + 1
"""Side in pixels of the window in which the colours of the object and of the background are modelled."""
_STEP = 0.03
"""Least relative depth difference across an outline; the surface itself changes less within the rim's width."""
_FEWEST = _REACH * _REACH
"""Least number of pixels to model the colour of either side."""
_LEAST_SPREAD = 5.0
"""Grey levels, 1 sigma, that noise and compression give to a surface of one colour."""
_SURE = 6.0
"""Twice the logarithm of the likelihood ratio, background to object, from which on a pixel is background: 20 : 1."""
_OTHER = 12.0
"""Squared distance, in variances of the background's colours, from which on a pixel does not show the background."""
_OPEN = 0.01
"""Least share of the picture of a region without depth that is background; smaller ones are untextured patches on the
object."""


def remove_rim(depth: Floats, rgb: Bytes) -> Floats:
    """Set depth (H,W) to 0 at outlines where the picture rgb (H,W,3) shows the background's colour; 0 is unknown.

    A surface that is too thin for a core, such as a stem, is known by the colours there that the background lacks.
    """
    import cv2

    near = _nearest_around(np.where(depth > 0, 1 / np.where(depth > 0, depth, 1), 0))
    thing = (depth > 0) & (depth * near < 1 + _STEP)
    core = cv2.erode(thing.astype(np.uint8), np.ones((2 * _REACH + 1,) * 2, np.uint8), borderValue=1) > 0
    colour = rgb.astype(np.float32)
    beyond = _Colours.of(colour, ~thing & _large_regions(~thing))
    thin = thing & beyond.known & (_sum_around(core.astype(np.float32)) < _FEWEST)
    alike = beyond.distance < _OTHER
    inside = _Colours.of(colour, core | (thin & ~alike))
    rim = thing & ~core & inside.known & beyond.known & (inside.unlikeness > beyond.unlikeness + _SURE)
    return np.where(rim & (alike | ~thin), np.float32(0), depth)


def _nearest_around(inverse: Floats) -> Floats:
    """Return the largest inverse depth (the nearest surface) within the rim's width of each pixel."""
    import cv2

    return np.asarray(cv2.dilate(inverse.astype(np.float32), np.ones((2 * _REACH + 1,) * 2, np.uint8)))


def _large_regions(mask: Bools) -> Bools:
    """Return the large connected regions of a mask (H,W)."""
    import cv2

    count, label, figures, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    large = figures[:count, cv2.CC_STAT_AREA] >= _OPEN * mask.size
    large[0] = False
    return np.asarray(large[label])


@dataclass(frozen=True, slots=True)
class _Colours:
    """How each pixel's colour (H,W,3) compares with those of certain pixels around it, as a normal distribution.

    distance    (H,W) squared distance from their mean, in variances
    unlikeness  (H,W) minus twice the logarithm of its likelihood, up to a constant
    known       (H,W) whether there are enough of them
    """

    distance: Floats
    unlikeness: Floats
    known: Bools

    @classmethod
    def of(cls, colour: Floats, which: Bools) -> _Colours:
        """Compare each pixel with those of the mask `which` (H,W) around it."""
        weight = which.astype(np.float32)
        count = np.maximum(_sum_around(weight), 1)
        mean = _sum_around(weight[..., None] * colour) / count[..., None]
        square = _sum_around(weight * np.einsum("hwc,hwc->hw", colour, colour)) / count
        spread = np.maximum(square - np.einsum("hwc,hwc->hw", mean, mean), 0) / 3 + _LEAST_SPREAD**2
        distance = np.einsum("hwc,hwc->hw", colour - mean, colour - mean) / spread
        return cls(distance, distance + 3 * np.log(spread), count >= _FEWEST)


def _sum_around(values: Floats) -> Floats:
    """Sum values (H,W) or (H,W,C) over the window around each pixel."""
    import cv2

    return np.asarray(cv2.boxFilter(values, cv2.CV_32F, (_AROUND, _AROUND), normalize=False))
