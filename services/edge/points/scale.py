"""Scale points by a length that a person measured, for captures whose scale is unknown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.points.nouns import Points

_MOST = 2_000
"""Most corners of the convex hull that are compared pair by pair."""


def scale_to_longest(points: Points, longest_m: float) -> Points:
    """Set the scale so that the two points farthest apart are `longest_m` metres apart; its confidence: "estimated"."""
    return with_scale(points, longest_m / span(points.xyz))


def with_scale(points: Points, metres_per_unit: float) -> Points:
    """Set the scale that a person has told. Its confidence is "estimated"."""
    return replace(points, metres_per_unit=metres_per_unit, scale_confidence="estimated", scale_by_model=False)


def span(xyz: Floats) -> float:
    """Return the greatest distance between two of the points (N,3); N >= 2, and not all points are equal."""
    from scipy.spatial import ConvexHull, QhullError
    from scipy.spatial.distance import pdist

    try:
        corners = xyz[ConvexHull(xyz).vertices]
    except QhullError:  # points on one plane or line have no hull: use all of them
        corners = xyz
    if len(corners) > _MOST:  # take the extreme points along many directions: the result is less than 0.1 % too small
        directions = np.random.default_rng(0).normal(size=(_MOST // 2, 3))
        along = corners @ directions.T
        corners = corners[np.unique(np.r_[along.argmin(axis=0), along.argmax(axis=0)])]
    return float(pdist(corners).max())
