"""Where surface comes from: it was measured, proposed as a guess, or filled to close what is around it.

One number for each point, face or vertex, the same in all files: the lower, the surer.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bools, Bytes, Floats

MEASURED, PROPOSED, FILLED = 0, 1, 2
"""Photos or a scanner saw it; a relief, a completion or a learned model guesses it; geometry closes it."""

NAMES = ("measured", "proposed", "filled")
"""Of the three, in reports and manifests, by their number."""

COLOURS = ((0, 158, 115), (230, 159, 0), (204, 121, 167))
"""sRGB of the three where a picture tells them apart: of the palette by Okabe and Ito, for all kinds of sight."""

PICTURE = "origin.png"
"""Name of the picture that shows them, from four sides."""


def told(origin: Bytes) -> Bytes | None:
    """Return origins (N,) uint8, or None where all are measured, which needs no telling."""
    return origin if origin.any() else None


def marked(which: Bools, as_what: int) -> Bytes | None:
    """Return origins (N,) uint8 of items of which some, by a mask (N,), are not measured; None where none is."""
    return told(np.where(which, as_what, MEASURED).astype(np.uint8))


def counts(origin: Bytes | None, count: int) -> dict[str, int]:
    """Count `count` items by their origin (N,), None where all are measured."""
    found = [count, 0, 0] if origin is None else np.bincount(origin, minlength=len(NAMES)).tolist()
    return dict(zip(NAMES, found, strict=True))


def shares(origin: Bytes, weight: Floats) -> dict[str, float]:
    """Divide a total weight (N,) ≥ 0 among the origins (N,): shares that add to 1; without a weight all is measured."""
    parts = np.bincount(origin, weight, len(NAMES))
    total = float(parts.sum())
    found = (parts / total).tolist() if total > 0 else (1.0, 0.0, 0.0)
    return dict(zip(NAMES, found, strict=True))


def nearest_origin(xyz: Floats, origin: Bytes | None, places: Floats) -> Bytes | None:
    """Return the origins (M,) of the nearest of points (N,3) with origins (N,) to places (M,3) in the same frame.

    None where all points are measured, or the nearest of all places are.
    """
    if origin is None:
        return None
    if (origin == origin[0]).all():  # such as of a relief: whichever is the nearest
        return told(np.full(len(places), origin[0]))
    return told(origin[cKDTree(xyz).query(places, workers=-1)[1]])
