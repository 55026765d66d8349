"""Compute the unit frame, in which a field is fitted."""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.points.nouns import UnitFrame
from capture2vr.sentences.sentence import say


def unit_frame(xyz: Floats) -> UnitFrame:
    """Return the frame that centres the bounding box of `xyz` (N,3) at 0 with its longest side 1.

    float64 throughout: georeferenced coordinates near 1e6 keep a nanometre. Points on one plane or line are fine.
    Raises CaptureError: CAPTURE_EMPTY without points, CAPTURE_DEGENERATE where all are equal or not finite.
    """
    xyz = np.asarray(xyz, np.float64)
    if not len(xyz):
        raise CaptureError("CAPTURE_EMPTY", say("no_points_to_reconstruct"))
    low, high = xyz.min(axis=0), xyz.max(axis=0)
    size = float((high - low).max())
    if not (np.isfinite(size) and size > 0):
        raise CaptureError("CAPTURE_DEGENERATE", say("all_points_same_position", count=len(xyz)))
    return UnitFrame(centre=low + (high - low) / 2, size=size)
