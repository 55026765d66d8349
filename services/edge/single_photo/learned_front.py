"""Shape the front of a relief by depth that a learned model proposes, and tell its size in metres.

The outline stays in the relief's middle plane, and its back the membrane: only the height of the front above the
outline is the model's. A plane through the depth beside the outline is taken away, so that what was photographed
aslant is not sheared.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from capture2vr.edge.arrays import Bools, Floats, smoothstep
from capture2vr.edge.single_photo.membrane import Membrane

_RIM = 2.0, 0.15  # beside the outline: from so many pixels on, to this share of the mask's greatest half width
_LEAST_RIM = 20  # pixels there with depth
_LEAST_KNOWN = 0.6  # share of the mask with depth
_FADED = 2.0, 8.0  # pixels from the outline between which the front goes over from the membrane's to the model's
_LOWEST = 0.1  # of the membrane's height: the front stays before the back
_HIGHEST = 0.75  # of the mask's longer side
_SMOOTH = 1.0  # pixels: sigma by which heights are smoothed
_METRES = 1e-3, 1e3  # of a pixel row as long as the mask: beyond, the model errs


@dataclass(frozen=True, slots=True)
class LearnedFront:
    """What a model makes of a relief: ratio (h,w), by which the front is higher than the membrane, and how many metres
    a pixel is long."""

    ratio: Floats
    pixel_m: float


def learned_front(depth: Floats, focal: float, mask: Bools, membrane: Membrane) -> LearnedFront | None:
    """Make the front of a mask (h,w) from depth (h,w) in metres, 0 where unknown.

    focal  focal length in pixels of the mask

    None where too little of the object has depth, or its size cannot be.
    """
    away = np.asarray(cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5), np.float64)
    known = mask & (depth > 0)
    rim = known & (away > _RIM[0]) & (away <= max(2 * _RIM[0], _RIM[1] * float(away.max())))
    if rim.sum() < _LEAST_RIM or known.sum() < _LEAST_KNOWN * mask.sum():
        return None
    pixel_m = float(np.median(depth[rim])) / focal
    rise = np.asarray((_plane(depth, rim) - depth) / pixel_m, np.float64)
    within = float(np.median((membrane.height - rise)[rim]))  # of the rim, before the outline's own plane
    rise += within
    pixel_m *= 1 + within / focal
    if not _METRES[0] < pixel_m * _longer(mask) < _METRES[1]:
        return None
    return LearnedFront(_ratio(rise, known, away, membrane.height, _HIGHEST * _longer(mask)), pixel_m)


def _plane(depth: Floats, rim: Bools) -> Floats:
    """The plane (h,w) that most of the depth at the rim lies in: by least squares, again without what is far off."""
    rows, columns = np.indices(depth.shape)
    basis = np.stack([np.ones(depth.shape), columns, rows], axis=-1)
    kept = rim
    for _ in range(3):
        plane, *_ = np.linalg.lstsq(basis[kept], depth[kept], rcond=None)
        off = np.abs(basis @ plane - depth)
        kept = rim & (off <= 2.5 * np.median(off[rim]) + 1e-9)
    return np.asarray(basis @ plane)


def _ratio(rise: Floats, known: Bools, away: Floats, height: Floats, highest: float) -> Floats:
    """Ratio (h,w) of heights to the membrane's, 1 at the outline, outside, and where nothing is known."""
    inside = height > 0
    low = np.where(inside, height, 1.0)
    ratio = np.where(known & inside, np.clip(rise, _LOWEST * low, np.maximum(highest, low)) / low, 1.0)
    weight = known.astype(np.float64)
    near = cv2.GaussianBlur(weight, (0, 0), _SMOOTH)
    smooth = cv2.GaussianBlur(weight * ratio, (0, 0), _SMOOTH) / np.maximum(near, 1e-9)
    share = np.where(known, smoothstep(away, _FADED), 0.0)
    return np.asarray(1 + share * (smooth - 1))


def _longer(mask: Bools) -> int:
    return max(int(np.ptp(places)) + 1 for places in np.nonzero(mask))
