"""Compute the distances from points to a mesh."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Floats, Ints
from capture2vr.edge.mesh.nouns import Mesh

_TRIANGLES = 16  # candidates by nearest centroid: triangles of an extracted mesh are alike in size, so these suffice
_TINY = 1e-12


def distance_to_mesh(xyz: Floats, mesh: Mesh) -> Floats:
    """Distances (N,) from points (N,3) to the mesh: to the nearest of the triangles with the nearest centroids."""
    corners = np.asarray(mesh.vertices, np.float64)[mesh.faces]
    # Used once: this tree is quick to build, though a little slower to query.
    tree = cKDTree(corners.mean(axis=1), balanced_tree=False, compact_nodes=False)
    near: Ints = tree.query(xyz, k=range(1, 1 + min(_TRIANGLES, len(corners))), workers=-1)[1]
    away = _to_triangles(np.repeat(xyz, near.shape[1], axis=0), corners[near.ravel()])
    nearest: Floats = away.reshape(near.shape).min(axis=1)
    return nearest


def _to_triangles(xyz: Floats, corners: Floats) -> Floats:
    """(M,) distance from each point (M,3) to its triangle (M,3,3): to its plane where the point is over it, else to a
    side."""
    sides = np.roll(corners, -1, axis=1) - corners
    aside = xyz[:, None] - corners
    normal = np.cross(sides[:, 0], sides[:, 1])
    length = np.linalg.norm(normal, axis=1)
    over = (np.einsum("mkx,mx->mk", np.cross(sides, aside), normal) >= 0).all(axis=1) & (length > 0)
    along = np.einsum("mkx,mkx->mk", aside, sides) / (np.einsum("mkx,mkx->mk", sides, sides) + _TINY**2)
    to_sides = np.linalg.norm(aside - np.clip(along, 0, 1)[..., None] * sides, axis=2).min(axis=1)
    to_plane = np.abs(np.einsum("mx,mx->m", aside[:, 0], normal)) / np.maximum(length, _TINY**2)
    away: Floats = np.where(over, to_plane, to_sides)
    return away
