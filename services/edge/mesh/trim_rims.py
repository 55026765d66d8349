"""Cut off the rims of a mesh that photos show to be background."""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Bools
from capture2vr.edge.mesh.clip import clip_to_manifold
from capture2vr.edge.mesh.edges import border_edges
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.pieces import SplitMesh
from capture2vr.edge.mesh.regions import average_over_faces, connected_regions
from capture2vr.edge.mesh.topology import compact

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
    trimmed = clip_to_manifold(mesh, average_over_faces(mesh.faces, cut[:, None] - _LEAST, _ROUNDS)[:, 0])
    return _without_crumbs(compact(trimmed), float(SplitMesh.of(mesh).areas.min()))


def _without_crumbs(mesh: Mesh, least: float) -> Mesh:
    """Drop pieces smaller than every piece before the cut, of area `least`, and than a thousandth of the mesh."""
    split = SplitMesh.of(mesh)
    return compact(mesh, np.flatnonzero((split.areas >= min(least, _CRUMB * float(split.areas.sum())))[split.piece]))
