"""Make a capture of points that are in memory, checked as those of a file are."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.nouns import Capture, Cloud
from capture2vr.edge.clouds.cloud import capture_of_cloud
from capture2vr.edge.clouds.cloud_parts import projected
from capture2vr.edge.clouds.colours import rgb8
from capture2vr.edge.errors import CaptureError
from capture2vr.order.reading import UnitName
from capture2vr.sentences.sentence import say

_NAME = "the array"  # in errors, where the name of a file would be


def capture_of_points(xyz: ArrayLike, rgb: ArrayLike | None = None, *, unit: UnitName = "") -> Capture:
    """Return a capture of kind "points".

    xyz   (N,3) positions in any unit
    rgb   (N,3) sRGB, bytes or floats in [0,1]; None: without colours
    unit  "deg": longitudes, latitudes and heights in metres, which are projected; others change nothing here

    Raises CaptureError for arrays of another shape, for too few or too many points, for points on a line, and where
    more than a tenth of them are not finite; fewer are dropped with a warning.
    """
    points = triples(xyz, "points")
    colours = None if rgb is None else rgb8(triples(rgb, "colours", len(points)))
    cloud = Cloud(points.astype(np.float64), colours)
    return capture_of_cloud(projected(cloud) if unit == "deg" else cloud, _NAME, "array")


def triples(values: ArrayLike, what: str, count: int | None = None) -> Floats:
    """Return an array of numbers (N,3), or (count,3). Raises CaptureError CAPTURE_UNREADABLE."""
    wanted = "(N, 3)" if count is None else f"({count}, 3), one row to a point"
    try:
        array = np.asarray(values)
        numeric = array.dtype.kind in "iuf"
    except ValueError:  # rows of different lengths
        array, numeric = np.empty(0), False
    if not numeric or array.ndim != 2 or array.shape[1] != 3 or count not in (None, len(array)):
        reason = f"has {what} of shape {array.shape} and type {array.dtype}; they must be numbers of the shape {wanted}"
        raise CaptureError("CAPTURE_UNREADABLE", reason, file=_NAME, hints=(say("pass_array_of_shape"),))
    return array
