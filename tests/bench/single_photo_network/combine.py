"""Put the points of several views of the network together, without those that no other view agrees with."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bools, Floats

_STRAY = 0.2  # of the radius: points farther from those of the other views are dropped, but never more than half


def combine(views: Sequence[Floats]) -> tuple[Floats, Floats, Bools]:
    """Put views together: points (N,3), how far each is from those of the other views (N,), and which are no strays."""
    apart = disagreement(views)
    return np.concatenate(views), apart, apart <= max(_STRAY, float(np.median(apart)))


def disagreement(views: Sequence[Floats]) -> Floats:
    """Points (n,3) of every view -> (sum of n,) distance of each to the nearest of every other view, on average."""
    trees = [cKDTree(each) for each in views]
    summed = [sum(tree.query(each)[0] for tree in trees) for each in views]  # its own distance is 0
    return np.concatenate(summed) / (len(views) - 1)
