"""Sample parts of a mesh: points with colours, sparser the farther they are from measured ones."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bools, Bytes, Floats
from capture2vr.edge.mesh.edges import edges_of, spread_values
from capture2vr.edge.mesh.normals import face_normals
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.sampling import sample
from capture2vr.edge.points.voxel_grid import voxel_keys
from capture2vr.edge.srgb import to_linear, to_srgb

_GRADES = ((0.0, 1.0), (4.0, 2.0), (12.0, 4.0))
"""Distances from measured points, and the inferred points' spacing from there on, both in spacings."""
_APART = 1.0
"""Spacings from measured points within which no points are inferred."""
_RINGS = 3
"""Rings of triangles around a part that are sampled too: between it and the last points is a gap of `_LOOSE`."""
_AROUND = 8
"""Points whose mean colour a vertex takes."""
_INNER = 2
"""Rings of triangles around a part whose colours do not count: background shines into them."""


def sample_parts(
    mesh: Mesh, chosen: Bools, tree: cKDTree, spacing: float, light: Floats | None
) -> tuple[Floats, Bytes | None]:
    """Sample chosen faces (F,): points (M,3), sparser far from measured ones, which a tree has, and their colours
    (M,3); light (V,3): of the mesh's vertices, linear, or None."""
    part = Mesh(mesh.vertices, mesh.faces[grown(mesh, chosen, _RINGS)])
    areas = np.linalg.norm(face_normals(part.vertices, part.faces), axis=1) / 2
    places = sample(part, max(1, int(2 * areas.sum() / spacing**2)), np.random.default_rng(0)).xyz
    away = tree.query(places, workers=-1)[0] / spacing
    places, away = places[away > _APART], away[away > _APART]
    taken = np.zeros(len(places), bool)
    for number, (first, apart) in enumerate(_GRADES):
        last = _GRADES[number + 1][0] if number + 1 < len(_GRADES) else np.inf
        index = np.flatnonzero((away >= first) & (away < last))
        _, one = np.unique(voxel_keys(places[index], apart * spacing), return_index=True)
        taken[index[one]] = True
    places = places[taken]
    if light is None:
        return places, None
    return places, to_srgb(light[cKDTree(mesh.vertices).query(places, workers=-1)[1]])


def spread_colours(mesh: Mesh, chosen: Bools, xyz: Floats, rgb: Bytes) -> Floats:
    """Return linear light (V,3) of a mesh's vertices: that of coloured points (N,3), smooth in chosen faces (F,)."""
    unknown = np.zeros(len(mesh.vertices), bool)
    unknown[mesh.faces[grown(mesh, chosen, _INNER)]] = True
    nearest = cKDTree(xyz).query(mesh.vertices, k=range(1, 1 + min(_AROUND, len(xyz))), workers=-1)[1]
    spread: Floats = to_linear(rgb)[nearest].mean(axis=1)
    return spread_values(spread, edges_of(mesh.faces).ends, unknown)


def grown(mesh: Mesh, chosen: Bools, rings: int) -> Bools:
    """Grow a choice of faces (F,) by rings of triangles."""
    for _ in range(rings):
        reached = np.zeros(len(mesh.vertices), bool)
        reached[mesh.faces[chosen]] = True
        chosen = np.asarray(reached[mesh.faces].any(axis=1))
    return chosen
