"""Cut off the rims of a mesh that photos show to be background."""

from __future__ import annotations

import numpy as np

from services.edge.arrays import Bools, Floats, Ints
from services.edge.mesh.clip import clip
from services.edge.mesh.edges import border_edges
from services.edge.mesh.manifold import to_manifold
from services.edge.mesh.normals import face_normals
from services.edge.mesh.nouns import Mesh
from services.edge.mesh.regions import average_over_faces, connected_regions
from services.edge.mesh.topology import compact, pieces_of

_ROUNDS = 2  # of averaging: without it the cut would run in the zigzag of the triangles
_CRUMB = 1e-3  # of the mesh's area
_LEAST = 0.3  # of a rim's triangles around a place that is cut off: with half, rims of one triangle's width would stay


def trim_rims(mesh: Mesh, outside: Bools) -> Mesh:
    """Cut off vertices that lie outside of the thing, (V,) in the mask, where they are connected to a border.

    What is surrounded by surface stays: a shadow or a print of the background's colour is no rim. Crumbs that the cut
    leaves go too. Colours are dropped.
    """
    if not outside.any():
        return mesh
    rim = np.zeros(len(mesh.vertices), bool)
    rim[border_edges(mesh.faces)] = True
    cut, _ = connected_regions(mesh.faces, outside, np.ones(len(mesh.faces)), rim)
    trimmed = clip(mesh, average_over_faces(mesh.faces, cut[:, None] - _LEAST, _ROUNDS)[:, 0])
    at = np.zeros(len(trimmed.vertices), bool)
    at[border_edges(trimmed.faces)] = True  # the cut only removes faces: every vertex between two fans is on the border
    return _without_crumbs(compact(to_manifold(trimmed, at)), float(_piece_areas(mesh)[1].min()))


def _without_crumbs(mesh: Mesh, least: float) -> Mesh:
    """Drop pieces smaller than every piece before the cut, of area `least`, and than a thousandth of the mesh."""
    piece, areas = _piece_areas(mesh)
    return compact(mesh, np.flatnonzero((areas >= min(least, _CRUMB * float(areas.sum())))[piece]))


def _piece_areas(mesh: Mesh) -> tuple[Ints, Floats]:
    """The connected piece (F,) of each face, and the area (P,) of each piece."""
    piece = pieces_of(mesh.faces)
    doubled = np.linalg.norm(face_normals(mesh.vertices, mesh.faces), axis=1)
    return piece, np.bincount(piece, doubled / 2).astype(np.float64)
