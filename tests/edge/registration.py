"""A cloud laid over a known surface by the similarity that brings it nearest: size and place are not judged."""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from services.edge.arrays import Floats

_STEPS = 20
_NEAR = 0.03  # of the surface's size: points farther from it belong to something else
_SOME = 20_000  # points enough for seven numbers


def laid_over(xyz: Floats, surface: Floats, normals: Floats, start: Floats) -> Floats:
    """(N,3) moved by `start` (4,4) and then by the similarity of least distances along the normals.

    Point to plane (Y. Chen, G. Medioni, 1992) with the scale as a seventh number: matching points to points instead
    shrinks whatever lacks a part of the surface.
    """
    tree = cKDTree(surface)
    near = _NEAR * float(np.ptp(surface, axis=0).max())
    centre = surface.mean(axis=0)
    xyz = trimesh.transform_points(xyz, start) - centre
    some = np.random.default_rng(0).permutation(len(xyz))[:_SOME]
    for _ in range(_STEPS):
        points = xyz[some]
        gap, nearest = tree.query(points + centre)
        on = gap < near
        points, normal = points[on], normals[nearest[on]]
        off = np.einsum("ni,ni->n", points + centre - surface[nearest[on]], normal)
        weight = 1 / np.maximum(np.abs(off), np.median(np.abs(off)))  # Huber's: the far ones pull no harder
        rows = np.concatenate(
            [np.cross(points, normal), normal, np.einsum("ni,ni->n", points, normal)[:, None]], axis=1
        )
        turn = np.linalg.lstsq(rows * weight[:, None], -off * weight, rcond=None)[0]
        xyz = (1 + turn[6]) * xyz @ Rotation.from_rotvec(turn[:3]).as_matrix().T + turn[3:6]
    moved: Floats = xyz + centre
    return moved
