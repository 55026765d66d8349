"""One length that a person measured, for captures that do not know how large anything is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from services.edge.arrays import Floats
from services.edge.points.nouns import Points

_MOST = 2_000
"""Corners of the hull that are compared pair by pair."""


def with_longest(points: Points, longest_m: float) -> Points:
    """The same points, two of which are `longest_m` metres apart and none farther; the scale then is an estimate."""
    return replace(points, metres_per_unit=longest_m / span(points.xyz), scale_confidence="estimated")


def span(xyz: Floats) -> float:
    """The greatest distance between two of the points (N,3), N >= 2 and not all in one place."""
    from scipy.spatial import ConvexHull, QhullError
    from scipy.spatial.distance import pdist

    try:
        corners = xyz[ConvexHull(xyz).vertices]
    except QhullError:  # flat, or in a line: then all of them may be corners
        corners = xyz
    if len(corners) > _MOST:  # the farthest along many directions: less than 0.1 % is lost
        ways = np.random.default_rng(0).normal(size=(_MOST // 2, 3))
        along = corners @ ways.T
        corners = corners[np.unique(np.r_[along.argmin(axis=0), along.argmax(axis=0)])]
    return float(pdist(corners).max())
