"""Find the cluster of points that the cameras aimed at, with all that belongs to it."""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Bools, Floats, Ints
from capture2vr.edge.points.outliers import label_components

LINK_SPACINGS = 4.0
"""Points within this many median spacings are connected."""
TOUCH_LINKS = 2.0
"""A cluster within this many links of the chosen one is a part of the object that the scan did not connect."""
_FLOATING_LINKS = 8.0
"""The same for a cluster that stands on nothing, such as the head of a flower on a stem without depth."""
_LOWEST, _HIGHEST = 2.0, 98.0
"""Percentiles of a cluster's heights that tell how far down and up it comes."""
_NEAR_MIDDLE = 0.05
"""Distance from the middle at which a cluster's points count half, as a share of the points' extent."""
LEAST_POINTS = 100
"""An object has at least this many points."""
_PROBE = 20_000
"""Points sampled to measure the spacing."""


def touching_distance(xyz: Floats) -> float:
    """Return the distance within which two clusters of points (N,3) belong together."""
    return TOUCH_LINKS * LINK_SPACINGS * spacing(xyz)


def cluster_near(xyz: Floats, candidates: Bools, height: Floats | None, middle: Floats | None) -> Bools:
    """Cluster the candidates (N,); return a mask (N,) of the large cluster near the middle (3,) and what belongs to it.

    height (N,)  over the ground, where it is known
    """
    thing = np.zeros(len(xyz), bool)
    index = np.flatnonzero(candidates)
    if len(index) < LEAST_POINTS:
        return thing
    left = xyz[index]
    link = LINK_SPACINGS * spacing(left)
    label = label_components(left, link)
    middle = np.median(left, axis=0) if middle is None else middle
    chosen = _choose(left, label, middle)
    thing[index[with_touching(left, label, chosen, link, None if height is None else height[index])]] = True
    return thing


def with_touching(xyz: Floats, label: Ints, chosen: Bools, link: float, height: Floats | None = None) -> Bools:
    """Return chosen points, a mask (N,) of clusters by their label (N,), with all clusters that touch them.

    link    distance within which points are connected
    height  (N,) over the ground; where it is known, what stands on nothing touches from farther away: nothing floats
    """
    from scipy.spatial import cKDTree

    chosen = chosen.copy()
    floats, stands = _over_ground(label, height, TOUCH_LINKS * link)
    while True:
        away, _ = cKDTree(xyz[chosen]).query(xyz[~chosen], distance_upper_bound=_FLOATING_LINKS * link, workers=-1)
        wide = floats[~chosen] | (stands[~chosen] & floats[chosen].all())
        touching = np.unique(label[~chosen][away < np.where(wide, _FLOATING_LINKS, TOUCH_LINKS) * link])
        if not len(touching):
            return chosen
        chosen |= np.isin(label, touching)


def _over_ground(label: Ints, height: Floats | None, near: float) -> tuple[Bools, Bools]:
    """Masks (N,) of the points whose cluster floats over the ground, and of those whose cluster stands on it; what does
    not rise from it is neither, nor are a few points in the air, and without heights (N,) nothing is."""
    if height is None:
        return np.zeros(len(label), bool), np.zeros(len(label), bool)
    order = np.lexsort((height, label))
    size = np.bincount(label)
    first = np.cumsum(size) - size
    lowest, highest = (height[order][first + (size * (part / 100)).astype(np.int64)] for part in (_LOWEST, _HIGHEST))
    rises = highest > 2 * near
    floats = rises & (lowest > near) & (size >= LEAST_POINTS)
    return floats[label], (rises & (lowest <= near))[label]


def _choose(xyz: Floats, label: Ints, middle: Floats) -> Bools:
    """Return a mask of the cluster with the most points, weighted down by the distance of its nearest point from the
    middle."""
    size = np.bincount(label)
    distance = np.full(len(size), np.inf)
    np.minimum.at(distance, label, np.linalg.norm(xyz - middle, axis=1))
    scale = _NEAR_MIDDLE * float(np.ptp(xyz, axis=0).max())
    return np.asarray(label == np.argmax(size / (1 + (distance / scale) ** 2)))


def spacing(xyz: Floats) -> float:
    """Return the median distance from a point to its nearest neighbour."""
    from scipy.spatial import cKDTree

    some = xyz[np.random.default_rng(0).permutation(len(xyz))[:_PROBE]]
    distance, _ = cKDTree(xyz).query(some, k=2, workers=-1)
    return float(np.median(distance[:, 1]))
