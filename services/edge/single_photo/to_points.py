"""Turn a capture of one photo into points, of the same form as those of many photos."""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Tick, no_tick
from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.models.folder import ModelFolder
from capture2vr.edge.origin import PROPOSED
from capture2vr.edge.points.nouns import CutReport, Points
from capture2vr.edge.single_photo.photo_window import USUAL_M
from capture2vr.edge.single_photo.relief import MOST_CONFIDENT, make_relief
from capture2vr.order.photo_box import PhotoBox
from capture2vr.sentences.sentence import say


def to_points(
    capture: Capture,
    *,
    box: PhotoBox | None = None,
    models: ModelFolder | None = None,
    size_known: bool = False,
    tick: Tick = no_tick,
) -> Points:
    """Guess the points of the thing in the one photo, or of what a person marked in it, y up.

    models      may cut it out, and tell its depth and size
    size_known  whether a person has told its size, so that nobody need know what a model thinks it is

    Raises CaptureError CAPTURE_NO_OBJECT.
    """
    (photo,) = capture.photos
    relief = make_relief(photo, box=box, models=models, tick=tick)
    warnings = capture.warnings + relief.warnings
    if relief.metres is not None and not size_known:
        size = say("size_by_model", name=photo.name, model=relief.sized_by, metres=relief.metres)
        warnings = (*warnings, size)
    return Points(
        xyz=relief.xyz,
        rgb=relief.rgb,
        confidence=np.full(len(relief.xyz), MOST_CONFIDENT, np.float32),
        metres_per_unit=relief.metres or USUAL_M,
        scale_confidence="estimated" if relief.metres else "unknown",
        scale_by_model=relief.metres is not None,
        up=np.array([0.0, 1.0, 0.0]),
        warnings=warnings,
        models=relief.models,
        texture_views=relief.views,
        cut=CutReport("object", say("photo_printed_on_outline")),
        closed=relief.closed,
        origin=np.full(len(relief.xyz), PROPOSED, np.uint8),
    )
