"""Lay a rough closed mesh on the points that it was fitted to, and smooth parts of it."""

from __future__ import annotations

import numpy as np
from scipy.sparse import diags_array
from scipy.sparse.linalg import cg
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bools, Floats
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
_FREE, _FIXED = 0.05, 100.0
"""Weights of the place of a vertex that is smoothed, and of another: creases some cells wide go, bulges stay."""
_EXACT_PLACES = 1e-6


def lay_on_points(mesh: Mesh, points: OrientedPoints, spacing: float, cell: float) -> tuple[Mesh, Floats]:
    """Move a closed mesh along its normals onto points, at most some cells away; between them smoothly.

    A point counts as far as its normal is the mesh's: those of a wall are not where the floor below it is.

    spacing  of the points; cell  of the grid that the mesh was made on
    Returned with how surely points say where each vertex is, (V,) in [0,1].
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
    sure = np.minimum((weight * points.weight[near]).sum(axis=1) / _SURE, 1)
    return Mesh(mesh.vertices + offset[:, None] * normals, mesh.faces), sure


def smooth_parts(mesh: Mesh, faces: Bools, sure: Floats) -> Mesh:
    """Move the vertices of chosen faces (F,) so that the surface bends less there, and goes on from that around it.

    sure (V,) in [0,1]: how surely points say where each vertex is; the surer, the less it moves
    """
    weight = np.full(len(mesh.vertices), _FIXED)
    moving = np.unique(mesh.faces[faces])
    weight[moving] = _FREE + sure[moving]
    bend = neighbour_laplacian(edges_of(mesh.faces).ends, len(mesh.vertices))
    matrix = (diags_array(weight) + _STIFF * (bend.T @ bend)).tocsr()
    scaled = diags_array(1 / matrix.diagonal())
    moved = [
        cg(matrix, weight * column, x0=column, rtol=_EXACT_PLACES, maxiter=_STEPS, M=scaled)[0]
        for column in mesh.vertices.T
    ]
    return Mesh(np.stack(moved, axis=1), mesh.faces)
