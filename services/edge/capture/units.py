"""Apply the unit that a person says coordinates have; degrees of longitude and latitude are projected to metres."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.nouns import Capture
from capture2vr.order.reading import METRES, UnitName
from capture2vr.sentences.sentence import say

_SEMI_MAJOR_M, _FLATTENING = 6_378_137.0, 1 / 298.257223563  # of WGS 84
_SMALL, _HIGH = 2.0, 20.0  # degrees that a survey spans at most, and how many times that its heights span in metres


def in_unit(capture: Capture, unit: UnitName) -> Capture:
    """Return a capture whose points have that unit; "" leaves it as it is, and so do pictures, which is said."""
    if not unit:
        return capture
    if capture.cloud is None:
        return replace(capture, warnings=(*capture.warnings, say("unit_of_points_alone")))
    return replace(capture, metres_per_unit=METRES[unit], scale_confidence="metric")


def project_degrees(xyz: Floats) -> Floats:
    """Project longitude and latitude (degrees, WGS 84) and height (m), (N,3), to metres east, north and up.

    Lengths are those of the ellipsoid at the median's latitude (equirectangular), from the median point: within
    0.1 % over ten kilometres.
    """
    known = xyz[np.isfinite(xyz).all(axis=1)]
    longitude, latitude, _ = np.median(known, axis=0) if len(known) else np.zeros(3)
    squared = _FLATTENING * (2 - _FLATTENING)
    sine = np.sin(np.radians(latitude))
    across = _SEMI_MAJOR_M / np.sqrt(1 - squared * sine**2)
    along = across * (1 - squared) / (1 - squared * sine**2)
    degree = np.radians(1.0)
    return np.asarray(
        (xyz - [longitude, latitude, 0]) * [degree * across * np.cos(np.radians(latitude)), degree * along, 1.0]
    )


def are_degrees(xyz: Floats) -> bool:
    """Return whether points (N,3) are hardly lengths, but longitudes, latitudes and heights in metres, or latitude
    first: next to each other, far from 0, and far higher than wide."""
    known = xyz[np.isfinite(xyz).all(axis=1)]
    if not len(known):
        return False
    span, away = np.ptp(known, axis=0), np.abs(known[:, :2])
    wide, within = span[:2].max(), away.max() <= 180 and away.max(axis=0).min() <= 90
    return bool(within and 0 < wide < _SMALL and _HIGH * wide < min(np.median(away, axis=0).max(), span[2]))
