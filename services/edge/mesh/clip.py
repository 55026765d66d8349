"""Cut a mesh along a level line of a scalar at its vertices, through the faces."""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Floats, Ints
from capture2vr.edge.mesh.edges import border_edges
from capture2vr.edge.mesh.manifold import to_manifold
from capture2vr.edge.mesh.nouns import Mesh

SNAP = 0.25  # of an edge: a cut this close to a vertex goes through it, or the border would be lined with slivers


def clip(mesh: Mesh, level: Floats) -> Mesh:
    """Return the part of the mesh where the (V,) level is at most 0, with new vertices where edges cross 0."""
    level = _snap(mesh.faces, level)
    # Rotate the corners of each cut face so that corner 0 is the only one outside, or the only one inside.
    outside = level[mesh.faces] > 0
    count = outside.sum(axis=1)
    whole = mesh.faces[(count == 0) & (level[mesh.faces] < 0).any(axis=1)]
    one, two = _rotate(mesh.faces[count == 1], level, True), _rotate(mesh.faces[count == 2], level, False)
    one = one[(level[one] < 0).any(axis=1)]
    two = two[level[two[:, 0]] < 0]
    cuts = np.concatenate([one[:, [0, 1]], one[:, [0, 2]], two[:, [0, 1]], two[:, [0, 2]]])
    vertices, number = _cut_vertices(mesh.vertices, level, cuts)
    n, k = len(one), len(two)
    toward_1, toward_2 = number[:n], number[n : 2 * n]
    faces = [
        whole,
        np.stack([toward_1, one[:, 1], one[:, 2]], axis=1),
        np.stack([toward_1, one[:, 2], toward_2], axis=1),
        np.stack([two[:, 0], number[2 * n : 2 * n + k], number[2 * n + k :]], axis=1),
    ]
    joined = np.concatenate(faces)
    return Mesh(vertices, joined[(joined != np.roll(joined, 1, axis=1)).all(axis=1)])


def clip_to_manifold(mesh: Mesh, level: Floats) -> Mesh:
    """Clip a manifold mesh as `clip` does, and cut it where fans of faces then touch."""
    clipped = clip(mesh, level)
    at = np.zeros(len(clipped.vertices), bool)
    at[border_edges(clipped.faces)] = True  # the cut only removes faces: every vertex between two fans is on the border
    return to_manifold(clipped, at)


def _snap(faces: Ints, level: Floats) -> Floats:
    """Set the level to 0 at vertices that the cut passes closely."""
    ends = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    a, b = level[ends[:, 0]], level[ends[:, 1]]
    cut = (a > 0) != (b > 0)
    ends, a, b = ends[cut], np.abs(a[cut]), np.abs(b[cut])
    share = a / np.maximum(a + b, 1e-30)
    snapped = level.copy()
    snapped[ends[share < SNAP, 0]] = 0
    snapped[ends[share > 1 - SNAP, 1]] = 0
    return snapped


def _rotate(faces: Ints, level: Floats, outside: bool) -> Ints:
    """Rotate the corners of faces so that the only one outside, or inside, comes first."""
    odd = np.argmax((level[faces] > 0) == outside, axis=1)
    return np.take_along_axis(faces, (odd[:, None] + np.arange(3)) % 3, axis=1)


def _cut_vertices(vertices: Floats, level: Floats, cuts: Ints) -> tuple[Floats, Ints]:
    """Add a vertex for every distinct cut edge -> all vertices, and the number of each cut's vertex."""
    ends = np.sort(cuts, axis=1)
    distinct, which = np.unique(ends, axis=0, return_inverse=True)
    a, b = level[distinct[:, 0]], level[distinct[:, 1]]
    t = np.abs(a) / np.maximum(np.abs(a) + np.abs(b), 1e-30)
    new = vertices[distinct[:, 0]] * (1 - t)[:, None] + vertices[distinct[:, 1]] * t[:, None]
    number = len(vertices) + which.ravel()
    # A cut at a snapped vertex is that vertex, not a copy of it.
    on = np.where(level[ends[:, 0]] == 0, ends[:, 0], np.where(level[ends[:, 1]] == 0, ends[:, 1], -1))
    return np.concatenate([vertices, new]), np.where(on >= 0, on, number)
