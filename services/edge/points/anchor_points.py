"""Summarise a point cloud by a few hundred points (the paper's anchors), shown while a mesh is still loading."""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats

ANCHORS = 512
"""Number of points: within the paper's 100 to 1,000; 15 kB of a manifest."""
_SOME = 20_000  # points of the cloud that are clustered, chosen at random
_ROUNDS = 8  # of Lloyd's algorithm; further rounds move no centre visibly
_GREY = 180  # of points without colours, 0 to 255


def cluster_anchors(xyz: Floats, rgb: Bytes | None, count: int = ANCHORS) -> tuple[Floats, Bytes]:
    """Cluster points (N,3) by k-means: centres (K,3) float64 and their colours (K,3) uint8, K <= count.

    A centre has the colour of the point nearest to it. Deterministic.
    """
    from scipy.spatial import cKDTree

    rng = np.random.default_rng(0)
    some = rng.permutation(len(xyz))[:_SOME]
    points = xyz[some]
    centres = points[:count].copy()
    for _ in range(_ROUNDS):
        _, nearest = cKDTree(centres).query(points)
        counts = np.bincount(nearest, minlength=len(centres))
        summed = np.stack([np.bincount(nearest, points[:, axis], len(centres)) for axis in range(3)], axis=1)
        centres = np.where(counts[:, None] > 0, summed / np.maximum(counts, 1)[:, None], centres)
    _, nearest = cKDTree(points).query(centres)
    colours = np.full((len(centres), 3), _GREY, np.uint8) if rgb is None else rgb[some[nearest]]
    return centres, colours
