"""Turn a capture of one photo into points, of the same form as those of many photos."""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Tick, no_tick
from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.models.folder import ModelFolder
from capture2vr.edge.origin import PROPOSED
from capture2vr.edge.points.nouns import CutReport, Points
from capture2vr.edge.single_photo.cutout import Tap
from capture2vr.edge.single_photo.relief import MOST_CONFIDENT, make_relief
from capture2vr.order.photo_box import PhotoBox
from capture2vr.sentences.sentence import say

_USUAL_M = 0.4
"""Metres of a thing that fills half of a picture taken at arm's length: an assumption, not a measurement."""


def to_points(
    capture: Capture,
    *,
    box: PhotoBox | None = None,
    tap: Tap | None = None,
    models: ModelFolder | None = None,
    tick: Tick = no_tick,
) -> Points:
    """Guess the points of the thing in the one photo, in a rectangle of it, or at a tap, y up. models: may cut it out

    Raises CaptureError CAPTURE_NO_OBJECT.
    """
    (photo,) = capture.photos
    relief = make_relief(photo, box=box, tap=tap, models=models, tick=tick)
    return Points(
        xyz=relief.xyz,
        rgb=relief.rgb,
        confidence=np.full(len(relief.xyz), MOST_CONFIDENT, np.float32),
        metres_per_unit=_USUAL_M,
        scale_confidence="unknown",
        up=np.array([0.0, 1.0, 0.0]),
        warnings=capture.warnings + relief.warnings,
        models=relief.models,
        texture_views=relief.views,
        cut=CutReport("object", say("photo_printed_on_outline")),
        closed=True,
        origin=np.full(len(relief.xyz), PROPOSED, np.uint8),
    )
