"""Find where a garment is open: at its neck, its sleeves and its hem. numpy and OpenCV.

The garment is one whose outline is wider above than below, with sleeves that stand off. Behind each opening the outline
is continued by a strip: where the inflated strip is cut away again, two sheets end side by side.
"""

from __future__ import annotations

import cv2
import numpy as np

from capture2vr.edge.arrays import Bools, Floats

_SMOOTH = 0.03
"""Of the height: an outline's folds are smaller, and say nothing about where it faces."""
_FACING = 0.6
"""Least cosine of what an outline faces to the direction in which an opening does."""
_HEM = 0.85
"""Share of the height below which the hem is."""
_NECK = 0.3
"""Share of the height above which the neck is."""
_LEAST_NECK = 0.08
"""Half of a closed collar's width, as a share of the garment's."""
_TIP = 0.7
"""Share of a sleeve's length behind which its end is."""
_END = 0.85
"""Share of the greatest distance from where it begins, of the places that tell which way a sleeve goes."""
_LEAST_SLEEVE = 0.08
"""Of the width: what stands off by less is no sleeve."""
_WAIST = slice(0.45, 0.9)
"""Shares of the height between which the trunk is narrowest."""


def open_ends(mask: Bools, reach: float) -> Bools:
    """Mask (h,w) of the strips behind the openings of a garment's mask (h,w), `reach` pixels long."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    top, height = int(rows[0]), len(rows)
    outline = mask & (cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) == 0)
    places = np.argwhere(outline)[:, ::-1].astype(np.float64)  # x, y
    outward = _outward(mask, _SMOOTH * height)[outline]
    low = (places[:, 1] - top) / height
    hem = (low > _HEM) & (outward[:, 1] > _FACING)
    neck = _neck(places, outward) & (low < _NECK)
    opening = hem | neck
    waist = _waist(mask, top, height)
    for side, edge in ((-1, columns[0]), (1, columns[-1])):
        opening |= _sleeve(places, outward, side, abs(edge - waist[0]), waist, len(columns))
    drawn = np.zeros(mask.shape, np.uint8)
    for (x, y), (right, down) in zip(places[opening], outward[opening], strict=True):
        end = round(float(x + reach * right)), round(float(y + reach * down))
        cv2.line(drawn, (int(x), int(y)), end, 1, 3)
    return np.asarray((drawn > 0) & ~mask)


def _outward(mask: Bools, smooth: float) -> Floats:
    """Unit directions (h,w,2) in which a mask ends."""
    soft = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), smooth)
    slope = np.stack([-cv2.Sobel(soft, cv2.CV_32F, 1, 0), -cv2.Sobel(soft, cv2.CV_32F, 0, 1)], axis=2)
    return np.asarray(slope / np.maximum(np.linalg.norm(slope, axis=2, keepdims=True), 1e-9), np.float64)


def _waist(mask: Bools, top: int, height: int) -> tuple[float, float]:
    """Middle and half of the width of the trunk where it is narrowest, in pixels."""
    part = mask[top + round(_WAIST.start * height) : top + round(_WAIST.stop * height)]
    runs = [np.flatnonzero(row)[[0, -1]] for row in part if row.any()]
    left, right = min(runs, key=lambda run: run[1] - run[0])
    return float(left + right) / 2, float(right - left) / 2


def _neck(places: Floats, outward: Floats) -> Bools:
    """Which places (N,2) of the outline are between the highest places of the left and the right half, or near the
    middle: a collar may be closed."""
    middle = float(places[:, 0].min() + places[:, 0].max()) / 2
    left, right = (places[side] for side in (places[:, 0] < middle, places[:, 0] >= middle))
    least = _LEAST_NECK * float(np.ptp(places[:, 0]))
    between = min(left[left[:, 1].argmin(), 0], middle - least), max(right[right[:, 1].argmin(), 0], middle + least)
    return np.asarray((places[:, 0] > between[0]) & (places[:, 0] < between[1]) & (outward[:, 1] < 0))


def _sleeve(places: Floats, outward: Floats, side: int, reach: float, waist: tuple[float, float], width: int) -> Bools:
    """Which places (N,2) of the outline are the end of the sleeve on a side (-1: left); reach: of its tip."""
    beside = side * (places[:, 0] - waist[0]) - waist[1]
    arm = beside > 0.2 * (reach - waist[1])
    if reach - waist[1] < _LEAST_SLEEVE * width or not arm.any():
        return np.zeros(len(places), bool)
    first = places[arm & (beside <= beside[arm].min() + 1)]
    away = places - [first[0, 0], (first[:, 1].min() + _next_below(first[:, 1])) / 2]
    far = np.linalg.norm(away, axis=1)
    axis = away[arm & (far > _END * far[arm].max())].mean(axis=0)
    axis /= max(float(np.linalg.norm(axis)), 1e-9)
    along = away @ axis
    return np.asarray(arm & (along > _TIP * along[arm].max()) & (outward @ axis > _FACING))


def _next_below(heights: Floats) -> float:
    """The end of a column's first part: the second of its crossings with the outline, in pixels from above."""
    found = np.unique(heights)
    apart = found[1:][np.diff(found) > 2]
    return float(apart[0] if len(apart) else found[-1])
