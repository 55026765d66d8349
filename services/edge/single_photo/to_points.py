"""A capture of one photo -> points, as a capture of many would give them."""

from __future__ import annotations

import numpy as np

from services.edge.arrays import Tick, no_tick
from services.edge.capture.nouns import Capture
from services.edge.guess.guess import guess
from services.edge.points import Points
from services.edge.points.smooth import smoothed

_USUAL_M = 0.4
"""Metres of a thing that fills half of a picture taken at arm's length: a place to start from, and no measurement."""
_NEIGHBOURS = 48, 32
"""Of 2,000 points: the looks scatter by a few percent, and a surface through all of them is a crumpled one."""


def to_points(capture: Capture, *, tick: Tick = no_tick) -> Points:
    """Points of the thing in the one photo, y up. Raises CaptureError CAPTURE_NO_OBJECT."""
    (photo,) = capture.photos
    guessed = guess(photo, tick=tick)
    return Points(
        xyz=smoothed(guessed.xyz, np.ones(len(guessed.xyz)), neighbours=_NEIGHBOURS),
        rgb=guessed.rgb,
        confidence=guessed.confidence,
        metres_per_unit=_USUAL_M,
        scale_confidence="unknown",
        up=np.array([0.0, 1.0, 0.0]),
        warnings=capture.warnings,
    )
