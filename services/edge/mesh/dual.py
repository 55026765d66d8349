"""Connect the crossed edges to a mesh: one quad per crossed edge, one vertex per layer of each cell.

Terms: every crossed edge has four cells around it, so its quad has four corners, and four faces, so its quad has four
sides. On each grid face the crossed edges are joined in pairs; a pair is a line of the surface across that face, and
joins the two quads' corners on both sides of the face. The joined corners of a cell are one vertex.

A side is thus shared by two quads at most and the corners around a vertex form one fan or one ring: a manifold with
boundary by construction, where two layers in a cell get a vertex each, and no sign is needed. Only two lines of one
face that end at the same two vertices still coincide; `clean` parts those.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from capture2vr.edge.arrays import Bools, Floats, Ints
from capture2vr.edge.mesh.crossings import Crossings
from capture2vr.edge.mesh.grid import STEP

# The corners of a quad are numbered 2·u + v, where its cell lies u steps back along the edge's first other axis and
# v along its second. Walking round the edge gives this order.
ROUND = np.array([0, 2, 3, 1])

# Per face around an edge: its corners on the face's upper and lower side (see `_face_keys` for the order of faces).
SIDES = np.array([[0, 2], [1, 3], [0, 1], [2, 3]])

# Ways of joining up to four edges of a face in pairs, by place in the group; a third edge stays alone. Opposite edges
# are never both joined when there are four: two layers do not pass through each other.
PAIRINGS: dict[int, tuple[tuple[tuple[int, int], ...], ...]] = {
    2: (((0, 1),),),
    3: (((0, 1),), ((0, 2),), ((1, 2),)),
    4: (((0, 1), (2, 3)), ((0, 2), (1, 3)), ((0, 3), (1, 2))),
}


def connect(crossings: Crossings) -> tuple[Ints, Ints]:
    """Connect the crossings -> quads (E,4) of vertices 0…V−1, and the vertex (4E,) of every corner 4·edge + number."""
    count = len(crossings.corner)
    links = _links(crossings, _face_keys(crossings))
    graph = coo_array((np.ones(len(links), np.int8), (links[:, 0], links[:, 1])), shape=(4 * count, 4 * count))
    vertex = connected_components(graph, directed=False)[1].astype(np.int64)
    return vertex.reshape(-1, 4)[:, ROUND], vertex


def _face_keys(crossings: Crossings) -> Ints:
    """(E,4) keys of the faces around each edge: two across its first other axis (v = 0, 1), two across its second."""
    corner, first, second = crossings.corner, (crossings.axis + 1) % 3, (crossings.axis + 2) % 3
    return np.stack(
        [
            corner * 3 + first,
            (corner - STEP[second]) * 3 + first,
            corner * 3 + second,
            (corner - STEP[first]) * 3 + second,
        ],
        axis=1,
    )


def _links(crossings: Crossings, face_keys: Ints) -> Ints:
    """Pairs (L,2) of corners that are the same vertex."""
    order = np.argsort(face_keys.ravel(), kind="stable")
    keys = face_keys.ravel()[order]
    start = np.flatnonzero(np.append(True, keys[1:] != keys[:-1])) if len(keys) else np.empty(0, np.int64)
    size = np.diff(np.append(start, len(keys)))
    links: list[Ints] = [np.empty((0, 2), np.int64)]
    for members in PAIRINGS:
        rows = order[start[size == members][:, None] + np.arange(members)]  # (G,members) into face_keys.ravel()
        best = _best_pairing(crossings, rows // 4, members)
        for choice, pairs in enumerate(PAIRINGS[members]):
            chosen = rows[best == choice]
            links += [_link(chosen[:, a], chosen[:, b]) for a, b in pairs]
    return np.concatenate(links)


def _link(row_a: Ints, row_b: Ints) -> Ints:
    """Pairs of corners of two edges, on the upper and on the lower side of their face."""
    a = (row_a // 4 * 4)[:, None] + SIDES[row_a % 4]
    b = (row_b // 4 * 4)[:, None] + SIDES[row_b % 4]
    return np.stack([a, b], axis=2).reshape(-1, 2)


def _best_pairing(crossings: Crossings, edges: Ints, members: int) -> Ints:
    """Choose for the edges (G,members) of faces the pairing (G,) whose lines lie flattest in the surface."""
    if members == 2:
        return np.zeros(len(edges), np.int64)
    costs = []
    for pairs in PAIRINGS[members]:
        cost = sum(_bend(crossings, edges[:, a], edges[:, b]) for a, b in pairs)
        through = sum((crossings.axis[edges[:, a]] == crossings.axis[edges[:, b]]) for a, b in pairs)
        costs.append(cost + np.where(through == 2, np.inf, 0.0))
    best: Ints = np.argmin(np.stack(costs, axis=1), axis=1)
    return best


def _bend(crossings: Crossings, a: Ints, b: Ints) -> Floats:
    """Measure how sharply the surface bends between two crossings: 0 in a plane, 2 at a right angle."""
    line = crossings.xyz[b] - crossings.xyz[a]
    line /= np.maximum(np.linalg.norm(line, axis=1, keepdims=True), 1e-12)
    n, m = crossings.normal[a], crossings.normal[b]
    off = np.abs(np.einsum("nx,nx->n", n, line)) + np.abs(np.einsum("nx,nx->n", m, line))
    bend: Floats = off + 1 - np.abs(np.einsum("nx,nx->n", n, m))
    return bend


def triangles(vertices: Floats, quads: Ints, normals: Floats) -> Ints:
    """Split quads along the diagonal whose two triangles agree better with the (E,3) normals of their edges."""
    ways = [quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 2, 3), quads[:, [1, 2, 3, 1, 3, 0]].reshape(-1, 2, 3)]
    scores = np.stack([_agreement(vertices, way, normals) for way in ways], axis=1)
    faces: Ints = np.where((scores[:, 1] > scores[:, 0])[:, None, None], ways[1], ways[0])
    return faces[_has_area(faces)].reshape(-1, 3)


def _agreement(vertices: Floats, pairs: Ints, normals: Floats) -> Floats:
    """(E,2,3) pairs of triangles -> (E,) the smaller cosine to the edge's normal."""
    corners = vertices[pairs]
    cross = np.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
    length = np.linalg.norm(cross, axis=2)
    cos = np.einsum("epx,ex->ep", cross, normals) / np.maximum(length, 1e-18)
    score: Floats = np.where(length > 0, cos, -1.0).min(axis=1)
    return score


def _has_area(pairs: Ints) -> Bools:
    """Triangles (E,2,3) -> (E,2): False for those that name a vertex twice."""
    a, b, c = pairs[..., 0], pairs[..., 1], pairs[..., 2]
    kept: Bools = (a != b) & (b != c) & (a != c)
    return kept
