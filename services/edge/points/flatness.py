"""Warn of points that nearly all lie on one plane: the photos then show a screen, a print or a wall, not a thing."""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.points.plane import largest_plane
from capture2vr.sentences.sentence import say

_REACH = 0.05
"""Distance from the plane, over the standard deviation of the points along its shorter side: photos of a screen have 92
to 96 % of the points within it, a bent shell 26 %."""
_SHARE = 0.9
"""Share of the points within that distance, from which on they count as flat."""


def flatness_warning(xyz: Floats) -> tuple[str, ...]:
    """Return a warning where nearly all points (N,3), N >= 3, lie on one plane."""
    side = float(np.sqrt(max(np.linalg.eigvalsh(np.cov(xyz.T))[1], 0.0)))
    plane = largest_plane(xyz, _REACH * side)
    if plane is None or np.mean(np.abs(plane.height(xyz)) <= _REACH * side) < _SHARE:
        return ()
    return (say("nearly_all_photos_show_lies"),)
