"""Lay a rough closed mesh on the points that it was fitted to, smoothly where there are none."""

from __future__ import annotations

import numpy as np
from scipy.sparse import diags_array
from scipy.sparse.linalg import cg
from scipy.spatial import cKDTree

from capture2vr.edge.closing.oriented_points import OrientedPoints
from capture2vr.edge.mesh.edges import edges_of, neighbour_laplacian
from capture2vr.edge.mesh.normals import vertex_normals
from capture2vr.edge.mesh.nouns import Mesh

_NEIGHBOURS = 12
_WIDE = 2.0  # spacings: standard deviation of the points' weights by their distance along the surface
_FARTHEST = 1.5  # cells off the mesh: what is farther is another surface
_SURE = 3.0  # sum of the weights from which on a place is known as well as with more
_STIFF = 1.0  # weight of the offsets' bending
_STILL = 0.01  # weight of no offset: bending alone goes on with a slope, and lifted a cup's whole bottom by a cell
_EXACT, _STEPS = 1e-4, 300


def lay_on_points(mesh: Mesh, points: OrientedPoints, spacing: float, cell: float) -> Mesh:
    """Move a closed mesh along its normals onto points, at most some cells away; between them smoothly.

    A point counts as far as its normal is the mesh's: those of a wall are not where the floor below it is.

    spacing  of the points; cell  of the grid that the mesh was made on
    """
    normals, xyz = vertex_normals(mesh), points.xyz
    away, near = cKDTree(xyz).query(mesh.vertices, k=range(1, 1 + min(_NEIGHBOURS, len(xyz))), workers=-1)
    off = np.einsum("vkx,vx->vk", xyz[near] - mesh.vertices[:, None], normals)
    aside = np.square(away) - np.square(off)
    alike = np.maximum(np.einsum("vkx,vx->vk", points.normal[near], normals), 0)
    weight = alike * np.exp(-aside / (_WIDE * spacing) ** 2) * (np.abs(off) < _FARTHEST * cell)
    total = weight.sum(axis=1)
    wanted = (weight * off).sum(axis=1) / np.maximum(total, 1e-9)
    known = np.minimum(total / _SURE, 1)
    bend = neighbour_laplacian(edges_of(mesh.faces).ends, len(mesh.vertices))
    matrix = (diags_array(known + _STILL) + _STIFF * (bend.T @ bend)).tocsr()
    offset, _ = cg(matrix, known * wanted, rtol=_EXACT, maxiter=_STEPS, M=diags_array(1 / matrix.diagonal()))
    return Mesh(mesh.vertices + offset[:, None] * normals, mesh.faces)
