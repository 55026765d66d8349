"""Apply the unit that a person says coordinates have, and tell degrees of longitude and latitude from lengths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.nouns import Capture
from capture2vr.order.reading import METRES, UnitName
from capture2vr.sentences.sentence import say

_SOME = 10_000  # points that are asked before all are
_SMALL, _HIGH = 2.0, 20.0  # degrees that a survey spans at most, and how many times that its heights span in metres


def in_unit(capture: Capture, unit: UnitName) -> Capture:
    """Return a capture whose points have that unit; "" leaves it as it is, and so do pictures, which is said."""
    if not unit:
        return capture
    if capture.cloud is None:
        return replace(capture, warnings=(*capture.warnings, say("unit_of_points_alone")))
    return replace(capture, metres_per_unit=METRES[unit], scale_confidence="metric")


def _are_near(xyz: Floats) -> bool:
    """Return whether points (N,3) without those that are not finite span few degrees across."""
    known = xyz[np.isfinite(xyz).all(axis=1), :2]
    return not len(known) or bool(np.ptp(known, axis=0).max() < _SMALL)


def are_degrees(xyz: Floats) -> bool:
    """Return whether points (N,3) are hardly lengths, but longitudes, latitudes and heights in metres, or latitude
    first: next to each other, far from 0, and far higher than wide."""
    if len(xyz) > _SOME and not _are_near(xyz[:_SOME]):  # most tables are told by their beginning
        return False
    known = xyz[np.isfinite(xyz).all(axis=1)]
    if not len(known):
        return False
    span, away = np.ptp(known, axis=0), np.abs(known[:, :2])
    wide, within = span[:2].max(), away.max() <= 180 and away.max(axis=0).min() <= 90
    return bool(within and 0 < wide < _SMALL and _HIGH * wide < min(np.median(away, axis=0).max(), span[2]))
