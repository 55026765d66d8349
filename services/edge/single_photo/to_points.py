"""Turn a capture of one photo into points, of the same form as those of many photos."""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Tick, no_tick
from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.points.denoise_stereo import smooth_stereo_points
from capture2vr.edge.points.nouns import Points
from capture2vr.edge.single_photo.guess import guess
from capture2vr.order.photo_box import PhotoBox

_USUAL_M = 0.4
"""Metres of a thing that fills half of a picture taken at arm's length: an assumption, not a measurement."""
_NEIGHBOURS = 96, 64
"""Neighbours that smooth 7,500 points: the views differ by a few percent, and a surface through all would crumple."""


def to_points(capture: Capture, *, box: PhotoBox | None = None, tick: Tick = no_tick) -> Points:
    """Guess the points of the thing in the one photo, or in a rectangle of it, y up.

    Raises CaptureError CAPTURE_NO_OBJECT.
    """
    (photo,) = capture.photos
    guessed = guess(photo, box=box, tick=tick)
    return Points(
        xyz=smooth_stereo_points(guessed.xyz, np.ones(len(guessed.xyz)), neighbours=_NEIGHBOURS),
        rgb=guessed.rgb,
        confidence=guessed.confidence,
        metres_per_unit=_USUAL_M,
        scale_confidence="unknown",
        up=np.array([0.0, 1.0, 0.0]),
        warnings=capture.warnings + guessed.warnings,
    )
