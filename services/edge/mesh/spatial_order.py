"""Vertices and faces in the order of their places, so that what is near in space is near in memory."""

from __future__ import annotations

import numpy as np

from services.edge.arrays import Ints
from services.edge.mesh.nouns import Mesh

_CELLS = 1023  # along the longest side: the most whose three numbers of 10 bits are spread over 32


def by_place(mesh: Mesh) -> Mesh:
    """The same mesh, its vertices along a Z-order curve (Morton 1966) and its faces by their first vertex on it.

    A collapse of 400,000 triangles that lie in no order takes twice as long, nearly all of it waiting for memory.
    """
    order = np.argsort(_along_the_curve(mesh), kind="stable")
    number = np.empty(len(order), np.int64)
    number[order] = np.arange(len(order))
    faces = number[mesh.faces]
    faces = faces[np.argsort(faces.min(axis=1), kind="stable")]
    return Mesh(mesh.vertices[order], faces, None if mesh.rgb is None else mesh.rgb[order])


def _along_the_curve(mesh: Mesh) -> Ints:
    """(V,) where on the curve the cell of a vertex lies: the bits of its three numbers in turn."""
    side = max(float(np.ptp(mesh.vertices, axis=0).max()), 1e-30)
    cell = ((mesh.vertices - mesh.vertices.min(axis=0)) / side * _CELLS).astype(np.int64)
    for by, mask in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
        cell = (cell | cell << by) & mask
    place: Ints = cell @ np.array([1, 2, 4])
    return place
