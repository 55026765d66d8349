"""Find connected regions of a mesh's vertices, and smooth values between neighbours: where a mesh is to be cut."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from capture2vr.edge.arrays import Bools, Floats, Ints
from capture2vr.edge.mesh.topology import vertex_pieces


def connected_regions(faces: Ints, chosen: Bools, areas: Floats, rim: Bools) -> tuple[Bools, Floats]:
    """Find the connected regions of chosen vertices, a mask (V,).

    Returns a mask (V,) of those whose region reaches the rim, a mask (V,) too, and (V,) the area of their region, of
    the faces' areas (F,).
    """
    corners = chosen[faces]
    some = np.flatnonzero(corners.any(axis=1))
    faces, corners = faces[some], corners[some]
    region, count = vertex_pieces(faces[corners.all(axis=1)], len(chosen))
    first = faces[np.arange(len(faces)), np.argmax(corners, axis=1)]
    area = np.bincount(region[first], areas[some] * corners.mean(axis=1), count)
    at_rim = np.zeros(count, bool)
    at_rim[region[rim]] = True
    return chosen & at_rim[region], np.where(chosen, area[region], 0)


def average_over_faces(faces: Ints, values: Floats, times: int) -> Floats:
    """Average values (V,C) over the faces around each vertex, repeatedly: this smooths the scallops of a level line."""
    weight = np.full(faces.size, 1 / 3)
    corners = csr_array((weight, faces.ravel(), np.arange(0, faces.size + 1, 3)), shape=(len(faces), len(values)))
    uses = np.maximum(np.bincount(faces.ravel(), minlength=len(values)), 1)[:, None]
    for _ in range(times):
        values = corners.T @ (corners @ values) * 3 / uses
    return values
