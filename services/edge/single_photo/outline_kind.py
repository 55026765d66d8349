"""Tell what kind of thing an outline may be of, by a few measures of it, and how thick it is inflated. OpenCV."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from capture2vr.edge.arrays import Bools, Floats

OutlineKind = Literal["flat", "round", "long", "leaf", "garment", "other"]


@dataclass(frozen=True, slots=True)
class Inflation:
    """How an outline is inflated: `limit` (L) and `thickness` of the membrane, in pixels; without a limit the thickness
    is the share k of what a ball's would be."""

    thickness: float
    limit: float = 0.0


@dataclass(frozen=True, slots=True)
class OutlineMeasures:
    """Measures of a mask's outline.

    long      longer over shorter side of the least rectangle around it
    filled    share of that rectangle that it fills: 1 for a rectangle, π/4 for an ellipse
    solid     share of its convex hull that it fills
    compact   4π area / perimeter², of the hull: 1 for a disc
    mirrored  intersection over union with its mirror image, about the vertical through its middle
    pointed   width of the first and the last tenth of its length over the greatest: 0.6 for an ellipse, 0.4 for a leaf,
              1 for a rectangle
    upper     width in its upper half over that in the lower
    """

    long: float
    filled: float
    solid: float
    compact: float
    mirrored: float
    pointed: float
    upper: float


_THICKNESS: dict[OutlineKind, float] = {"round": 0.8, "long": 0.7, "other": 0.7}
"""Share k of a ball's thickness: a strip's is √2 of that, so that something long is round."""
_PLATES: dict[OutlineKind, tuple[float, float]] = {"flat": (0.05, 0.03), "leaf": (0.02, 0.25), "garment": (0.13, 0.12)}
"""Half thickness and limit, as shares of the root of the area."""


def _is_garment(outline: OutlineMeasures) -> bool:
    """Whether an outline is mirrored, and wider above than below by what may be sleeves or straps."""
    wider_above = outline.upper > 1.15 and outline.long < 1.7
    return wider_above and outline.mirrored > 0.85 and 0.6 < outline.solid < 0.9


_KINDS: tuple[tuple[OutlineKind, Callable[[OutlineMeasures], bool]], ...] = (
    ("flat", lambda outline: outline.filled > 0.9 and outline.solid > 0.96),
    ("leaf", lambda outline: outline.solid > 0.9 and outline.pointed < 0.48 and 1.5 < outline.long < 5),
    ("long", lambda outline: outline.long > 2.6),
    ("round", lambda outline: outline.compact > 0.86 and outline.solid > 0.95),
    ("garment", _is_garment),
)
"""Kinds with what tells them; the first that fits counts."""


def inflation_of(mask: Bools) -> tuple[OutlineKind, Inflation]:
    """Tell the kind of a mask's outline, and how it is inflated."""
    kind = kind_of(measure(mask))
    root = float(np.sqrt(mask.sum()))
    if kind in _PLATES:
        thickness, limit = _PLATES[kind]
        return kind, Inflation(thickness * root, limit * root)
    return kind, Inflation(_THICKNESS[kind])


def kind_of(outline: OutlineMeasures) -> OutlineKind:
    """Tell the kind of an outline; "other" where none is sure."""
    return next((kind for kind, is_of_it in _KINDS if is_of_it(outline)), "other")


def measure(mask: Bools) -> OutlineMeasures:
    """Measure the outline of a mask (h,w), of all its parts together."""
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    hull = cv2.convexHull(np.concatenate(contours))
    area, hull_area = float(mask.sum()), max(float(cv2.contourArea(hull)), 1.0)
    (_, _), sides, _ = cv2.minAreaRect(hull)
    longer, shorter = max(sides) + 1, min(sides) + 1
    perimeter = max(float(cv2.arcLength(hull, closed=True)), 1.0)
    return OutlineMeasures(
        long=longer / shorter,
        filled=min(1.0, area / (longer * shorter)),
        solid=min(1.0, area / hull_area),
        compact=4 * np.pi * hull_area / perimeter**2,
        mirrored=_mirrored(mask),
        pointed=_pointed(mask),
        upper=_upper(mask),
    )


def _mirrored(mask: Bools) -> float:
    columns = np.flatnonzero(mask.any(axis=0))
    part = mask[:, columns[0] : columns[-1] + 1]
    both = (part & part[:, ::-1]).sum(), (part | part[:, ::-1]).sum()
    return float(both[0] / both[1])


def _pointed(mask: Bools) -> float:
    """Mean width of the first and the last tenth of the length over the greatest width, along the longest axis."""
    places = np.argwhere(mask) - np.argwhere(mask).mean(axis=0)
    _, axes = np.linalg.eigh(places.T @ places)
    along, across = (places @ axes[:, ::-1]).T
    widths = _widths(along, across)
    return float((widths[0] + widths[-1]) / 2 / max(widths.max(), 1e-9))


def _widths(along: Floats, across: Floats) -> Floats:
    """Widths (10,) of places in ten slices of their length."""
    edges = np.linspace(along.min(), along.max() + 1e-6, 11)
    slice_of = np.digitize(along, edges) - 1
    return np.array([np.ptp(across[slice_of == number]) if (slice_of == number).any() else 0.0 for number in range(10)])


def _upper(mask: Bools) -> float:
    rows = np.flatnonzero(mask.any(axis=1))
    widths = [np.ptp(np.flatnonzero(mask[row])) for row in rows]
    half = len(widths) // 2
    return float(np.max(widths[:half], initial=1)) / float(np.max(widths[half:], initial=1))
