"""Cluster points by the gaps between them, and choose the object in the middle."""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Bools, Floats, Ints
from capture2vr.edge.points.outliers import label_components

LINK_SPACINGS = 4.0
"""Points within this many median spacings are connected."""
TOUCH_LINKS = 2.0
"""A cluster within this many links of the chosen one is a part of the object that the scan did not connect."""
_NEAR_MIDDLE = 0.05
"""Distance from the middle at which a cluster's points count half, as a share of the points' extent."""
_PROBE = 20_000
"""Points sampled to measure the spacing."""
LEAST_POINTS = 100
"""An object has at least this many points."""


def cluster_near(xyz: Floats, candidates: Bools, middle: Floats | None) -> Bools:
    """Cluster the candidates (N,); return a mask (N,) of the large cluster near the middle (3,) and what touches it."""
    thing = np.zeros(len(xyz), bool)
    index = np.flatnonzero(candidates)
    if len(index) < LEAST_POINTS:
        return thing
    left = xyz[index]
    link = LINK_SPACINGS * spacing(left)
    label = label_components(left, link)
    middle = np.median(left, axis=0) if middle is None else middle
    chosen = _choose(left, label, middle)
    thing[index[with_touching(left, label, chosen, TOUCH_LINKS * link)]] = True
    return thing


def with_touching(xyz: Floats, label: Ints, chosen: Bools, reach: float) -> Bools:
    """Return chosen points, a mask (N,) of clusters by their label (N,), with all clusters within `reach` of them."""
    from scipy.spatial import cKDTree

    chosen = chosen.copy()
    while True:
        away, _ = cKDTree(xyz[chosen]).query(xyz[~chosen], distance_upper_bound=reach, workers=-1)
        touching = np.unique(label[~chosen][np.isfinite(away)])
        if not len(touching):
            return chosen
        chosen |= np.isin(label, touching)


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
