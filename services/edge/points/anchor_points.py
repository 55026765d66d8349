"""A few hundred points that stand for the whole cloud: the paper's anchors, shown while a mesh is on its way."""

from __future__ import annotations

import numpy as np

from services.edge.arrays import Bytes, Floats

HINTS = 512
"""Of the paper's 100 to 1,000; 15 kB of a manifest."""
_SOME = 20_000
_ROUNDS = 8  # of Lloyd's; more move no centre by what an eye would see
_GREY = 180


def hints(xyz: Floats, rgb: Bytes | None, count: int = HINTS) -> tuple[Floats, Bytes]:
    """k-means centres of points (N,3) with colours (N,3) or None -> (K,3) float64, (K,3) uint8, K <= count.

    The colour is that of the point next to a centre. Deterministic.
    """
    from scipy.spatial import cKDTree

    rng = np.random.default_rng(0)
    some = rng.permutation(len(xyz))[:_SOME]
    points = xyz[some]
    centres = points[:count].copy()
    for _ in range(_ROUNDS):
        _, nearest = cKDTree(centres).query(points)
        held = np.bincount(nearest, minlength=len(centres))
        summed = np.stack([np.bincount(nearest, points[:, axis], len(centres)) for axis in range(3)], axis=1)
        centres = np.where(held[:, None] > 0, summed / np.maximum(held, 1)[:, None], centres)
    _, nearest = cKDTree(points).query(centres)
    colours = np.full((len(centres), 3), _GREY, np.uint8) if rgb is None else rgb[some[nearest]]
    return centres, colours
