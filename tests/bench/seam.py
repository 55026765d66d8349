"""Tell how uneven a mesh is where measured surface meets surface that was filled in: a seam."""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bools
from capture2vr.edge.mesh.nouns import Mesh

_REACH = 8.0
"""Edges from measured and from filled surface within which a place is on the seam."""
_TITLES = "seam °", "skin °"


def seam_figures(mesh: Mesh, filled: Bools) -> dict[str, float | None]:
    """Mean angle in degrees between neighbouring triangles on the seam, and away from it on what was measured.

    filled (V,): mask of the vertices that nobody measured
    """
    known = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    made = filled[mesh.faces].all(axis=1)
    if not made.any() or made.all():
        return dict.fromkeys(_TITLES)
    angle, pair = np.degrees(known.face_adjacency_angles), known.face_adjacency[:, 0]
    middle, reach = known.triangles_center, _REACH * float(np.median(known.edges_unique_length))
    near_made, near_known = (
        np.isfinite(cKDTree(middle[which]).query(middle[pair], distance_upper_bound=reach, workers=-1)[0])
        for which in (made, ~made)
    )
    masks = near_made & near_known, ~near_made
    return {
        title: round(float(angle[mask].mean()), 2) if mask.any() else None
        for title, mask in zip(_TITLES, masks, strict=True)
    }
