"""Sort the vertices and faces of a mesh in space, so that what is near in space is near in memory."""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Ints
from capture2vr.edge.mesh.nouns import Mesh

_CELLS = 1023  # along the longest side: the most for three numbers of 10 bits, interleaved in 32


def by_place(mesh: Mesh) -> Mesh:
    """Sort the vertices along a Z-order curve (Morton 1966), and the faces by their first vertex on it.

    A collapse of 400,000 unsorted triangles takes twice as long, nearly all of it waiting for memory.
    """
    order = np.argsort(_morton_codes(mesh), kind="stable")
    number = np.empty(len(order), np.int64)
    number[order] = np.arange(len(order))
    faces = number[mesh.faces]
    faces = faces[np.argsort(faces.min(axis=1), kind="stable")]
    return mesh.with_vertices(order, faces)


def _morton_codes(mesh: Mesh) -> Ints:
    """Morton code (V,) of each vertex's cell: the interleaved bits of its three numbers."""
    side = max(float(np.ptp(mesh.vertices, axis=0).max()), 1e-30)
    cell = ((mesh.vertices - mesh.vertices.min(axis=0)) / side * _CELLS).astype(np.int64)
    for by, mask in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
        cell = (cell | cell << by) & mask
    place: Ints = cell @ np.array([1, 2, 4])
    return place
