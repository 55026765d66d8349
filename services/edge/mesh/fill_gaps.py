"""Fill holes of a cleaned mesh that are missing surface, not true openings.

1. span    every border loop gets the triangulation of least area
2. judge   it stays open where the patch leaves the surface's plane, as over the end of a sleeve or the mouth of a cup,
           and where views saw through the patch, into free space
3. refine  the patch's edges are split until they are as long as the border's
4. fair    its vertices go where the surface is as smooth as across the border (biharmonic; M. Botsch, O. Sorkine, "On
           linear variational surface deformation methods", 2008), and slivers that came of it are flipped

P. Liepa, "Filling holes in meshes", 2003, has the same steps, but judges nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse.linalg import splu

from capture2vr.edge.arrays import Bytes, Floats, Ints, Tick, no_tick
from capture2vr.edge.mesh.edges import border_edges, border_loops, edges_of, neighbour_laplacian
from capture2vr.edge.mesh.holes import edges_between, triangulate_loop
from capture2vr.edge.mesh.normals import face_normals
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.sampling import area, sample
from capture2vr.edge.origin import FILLED, MEASURED, nearest_origin, shares
from capture2vr.order.option_table import Fill

MOST_CORNERS = 400
"""Vertices of a loop: the triangulation takes 0.5 s then, and a longer loop is no hole but a border."""
_MOST_WORK = 40
"""Loops of that length, or as much work of shorter ones, that are triangulated: 20 s."""
_FEWEST = 3
_CONTINUES, _LIES_BACK = 0.5, -0.5
"""Least mean cosine between the surface's normals along a loop and the patch's: for a hole in a surface, and for any
patch. Over the end of a tube it is 0, over the border of a sheet, whose patch would lie back on it, -1."""
_SEE_PAST = 2
"""Views that see past a place, from which on it is free space: one may err."""
_MOST_FREE = 0.15
"""Share of a patch in free space up to which it is filled: depth is wrong by a pixel at outlines."""
_ASKED = 100
"""Places of each patch that views are asked about: their share is known to within 4 %."""
_LONGER = 1.5
"""Length of an edge over that of the border's edges, from which on it is split."""
_ROUNDS = 8
"""Rounds of splitting; each halves the longest edges."""
_FLIP_ROUNDS, _ANGLE_TOLERANCE = 10, 1e-6
"""Rounds of flipping behind each round of splitting, and radians over 180 degrees that are no reason to flip."""


Ask = Callable[[Floats, Floats], Ints]
"""Function from places (N,3) and unit normals (N,3) to the number of views (N,) that see past each, into free space."""


@dataclass(frozen=True, slots=True)
class FilledMesh:
    """A mesh with its holes filled: origin (F,) uint8 of its faces, as `edge/origin.py`."""

    mesh: Mesh
    origin: Bytes

    @classmethod
    def unfilled(cls, mesh: Mesh) -> FilledMesh:
        """Wrap a mesh without filling any hole."""
        return cls(mesh, np.full(len(mesh.faces), MEASURED, np.uint8))

    def with_origin_of(self, xyz: Floats, origin: Bytes | None) -> FilledMesh:
        """Return the same mesh whose faces that fill no hole have the origin of the points that they were made from.

        xyz (N,3) the points in the mesh's frame; origin (N,) theirs, None where all were measured
        """
        nearest = nearest_origin(xyz, origin, self.mesh.vertices[self.mesh.faces].mean(axis=1))
        return self if nearest is None else FilledMesh(self.mesh, np.maximum(self.origin, nearest))

    @property
    def vertex_origin(self) -> Bytes | None:
        """Origin (V,) of the vertices, of several faces' the surest; None where all are measured."""
        surest = np.full(len(self.mesh.vertices), FILLED, np.uint8)
        np.minimum.at(surest, self.mesh.faces, self.origin[:, None])
        return surest if self.origin.any() else None

    @property
    def shares(self) -> dict[str, float]:
        """Shares of the mesh's area by its origin's name."""
        return shares(self.origin, np.linalg.norm(face_normals(self.mesh.vertices, self.mesh.faces), axis=1))


def fill_gaps(mesh: Mesh, fill: Fill, ask: Ask, *, closed: bool = False, tick: Tick = no_tick) -> FilledMesh:
    """Fill the holes of a mesh without colours that are missing surface.

    closed  whether the surface is known to have no true openings: "all" then fills every hole

    The mesh must be manifold, its border vertices with two border edges each, its faces oriented alike around a hole.
    """
    if fill == "none" or not len(mesh.faces):
        return FilledMesh.unfilled(mesh)
    edges = edges_of(mesh.faces)
    border = edges.border(mesh.faces)
    index = _EdgeIndex(border, len(mesh.vertices))
    normals = _unit_normals(mesh.vertices, mesh.faces[edges.halves(1)[:, 0] // 3])
    chords = edges_between(mesh.faces, border)
    every = closed and fill == "all"
    least = _LIES_BACK if closed or fill == "all" else _CONTINUES
    patches = []
    loops = _loops_within_budget(border_loops(mesh.faces, border))
    for number, loop in enumerate(loops):
        faces = triangulate_loop(mesh.vertices[loop], loop, chords)
        if len(faces) and (every or _bend(mesh.vertices, faces, loop, index, normals) >= least):
            patches.append(faces)
        tick(0.6 * (number + 1) / len(loops))
    patches = patches if every else _not_free(mesh.vertices, patches, ask)
    tick(0.8)
    if not patches:
        return FilledMesh.unfilled(mesh)
    vertices, added = _refine(mesh.vertices, np.concatenate(patches), chords)
    vertices = _fair(Mesh(vertices, np.concatenate([mesh.faces, added])), len(mesh.vertices))
    # Beside a jagged border, what was no sliver before may be one now, and folded.
    whole = Mesh(vertices, np.concatenate([mesh.faces, _flip_edges(vertices, added, chords)]))
    added_from = np.arange(len(whole.faces)) >= len(mesh.faces)
    return FilledMesh(whole, np.where(added_from, FILLED, MEASURED).astype(np.uint8))


def _loops_within_budget(loops: list[Ints]) -> list[Ints]:
    """Return the loops short enough to triangulate, shortest first, as many as the time allows."""
    chosen = sorted((loop for loop in loops if _FEWEST <= len(loop) <= MOST_CORNERS), key=len)
    work = np.cumsum([float(len(loop)) ** 3 for loop in chosen])
    return chosen[: int(np.searchsorted(work, _MOST_WORK * MOST_CORNERS**3, side="right"))]


class _EdgeIndex:
    """Finds undirected edges among `ends` (E,2) of a mesh with `count` vertices."""

    def __init__(self, ends: Ints, count: int) -> None:
        keys = _keys(ends, count)
        self._order, self._count = np.argsort(keys), count
        self._keys = keys[self._order]

    def find(self, one: Ints, other: Ints) -> Ints:
        """Indices (N,) of the edges between vertices `one` (N,) and `other` (N,), all of which there are."""
        wanted = _keys(np.column_stack([one, other]), self._count)
        found: Ints = self._order[np.searchsorted(self._keys, wanted)]
        return found


def _bend(vertices: Floats, patch: Ints, loop: Ints, border: _EdgeIndex, normals: Floats) -> float:
    """Return the mean cosine between the normals of the surface and of its patch along a loop, weighted by length.

    normals (B,3): of the surface at each edge of the border.
    """
    after = np.roll(loop, -1)
    ends = patch[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    across = _unit_normals(vertices, patch)[_EdgeIndex(ends, len(vertices)).find(loop, after) // 3]
    length = np.linalg.norm(vertices[after] - vertices[loop], axis=1)
    cosine = np.einsum("nx,nx->n", normals[border.find(loop, after)], across)
    return float((length * cosine).sum()) / max(float(length.sum()), 1e-300)


def _unit_normals(vertices: Floats, faces: Ints) -> Floats:
    normals = face_normals(vertices, faces)
    unit: Floats = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    return unit


def _not_free(vertices: Floats, patches: list[Ints], ask: Ask) -> list[Ints]:
    """Return the patches that views do not see through; one without area hides nothing."""
    areas = [area(Mesh(vertices, patch)) for patch in patches]
    flat = [patch for patch, size in zip(patches, areas, strict=True) if not size > 0]
    wide = [patch for patch, size in zip(patches, areas, strict=True) if size > 0]
    if not wide:
        return flat
    rng = np.random.default_rng(0)
    # Middles of the triangles would be few, long ones' anywhere: how a flat hole is triangulated is a matter of chance.
    samples = [sample(Mesh(vertices, patch), _ASKED, rng) for patch in wide]
    past = ask(np.concatenate([each.xyz for each in samples]), np.concatenate([each.normals for each in samples]))
    free = (past >= _SEE_PAST).reshape(len(wide), _ASKED).mean(axis=1)
    return flat + [patch for patch, share in zip(wide, free, strict=True) if share <= _MOST_FREE]


def _refine(vertices: Floats, patch: Ints, chords: Ints) -> tuple[Floats, Ints]:
    """Split the inner edges of patches (F,3) that are longer than those of their borders; border edges stay."""
    border = border_edges(patch)
    longest = _LONGER * float(np.median(np.linalg.norm(vertices[border[:, 0]] - vertices[border[:, 1]], axis=1)))
    for _ in range(_ROUNDS):
        edges = edges_of(patch)
        inner = edges.size == 2
        length = np.linalg.norm(vertices[edges.ends[:, 0]] - vertices[edges.ends[:, 1]], axis=1)
        split = inner & (length > longest)
        if not split.any():
            break
        middle = np.full(len(edges.size), -1)
        middle[split] = len(vertices) + np.arange(split.sum())
        vertices = np.concatenate([vertices, vertices[edges.ends[split]].mean(axis=1)])
        of_half = np.empty(3 * len(patch), np.int64)
        of_half[edges.order] = np.repeat(middle, edges.size)
        patch = _flip_edges(vertices, _split_faces(patch, of_half.reshape(-1, 3)), chords)
    return vertices, patch


def _flip_edges(vertices: Floats, patch: Ints, chords: Ints) -> Ints:
    """Flip inner edges whose opposite angles add up to more than 180 degrees (Delaunay): no slivers are left to fold.

    chords (C,2): edges that the mesh has elsewhere between vertices of the border; none is made again.
    """
    count = len(vertices)
    others = _keys(chords, count)
    for _ in range(_FLIP_ROUNDS):
        edges = edges_of(patch)
        half = edges.halves(2)
        face, corner = half // 3, half % 3
        apex = patch[face, (corner + 2) % 3]
        start, end = patch[face[:, 0], corner[:, 0]], patch[face[:, 0], (corner[:, 0] + 1) % 3]
        angles = _angle(vertices, apex[:, 0], start, end) + _angle(vertices, apex[:, 1], start, end)
        sharpest = np.argsort(-angles, kind="stable")
        new = _keys(apex, count)
        # An edge that exists already would get a third face.
        allowed = (angles > np.pi + _ANGLE_TOLERANCE) & (apex[:, 0] != apex[:, 1])
        allowed &= ~np.isin(new, others) & ~np.isin(new, _keys(edges.ends, count))
        chosen = _without_neighbours(sharpest[allowed[sharpest]], face, new)
        if not len(chosen):
            break
        (one, other), (left, right) = face[chosen].T, apex[chosen].T
        patch = patch.copy()
        patch[one] = np.stack([left, start[chosen], right], axis=1)
        patch[other] = np.stack([right, end[chosen], left], axis=1)
    return patch


def _keys(ends: Ints, count: int) -> Ints:
    """One number (E,) for each undirected edge (E,2) of a mesh with `count` vertices."""
    keys: Ints = ends.min(axis=1) * count + ends.max(axis=1)
    return keys


def _without_neighbours(wanted: Ints, face: Ints, new: Ints) -> Ints:
    """Choose edges of `wanted` (K,), the first ones first, of which no two share a face or would become the same edge.

    face (E,2): the faces beside each edge; new (E,): key of the edge that each would become.
    """
    _, same = np.unique(new[wanted], return_inverse=True)
    claims = np.column_stack([face[wanted], same + face.max(initial=0) + 1])
    waiting, chosen = np.arange(len(wanted)), []
    while len(waiting):
        first = np.full(claims.max() + 1, len(wanted))
        np.minimum.at(first, claims[waiting], waiting[:, None])
        wins = (first[claims[waiting]] == waiting[:, None]).all(axis=1)
        chosen.append(waiting[wins])
        taken = np.zeros(len(first), bool)
        taken[claims[chosen[-1]]] = True
        waiting = waiting[~taken[claims[waiting]].any(axis=1)]
    return wanted[np.sort(np.concatenate(chosen))] if chosen else wanted[:0]


def _angle(vertices: Floats, apex: Ints, one: Ints, other: Ints) -> Floats:
    """Angles (N,) in radians at each apex between two other vertices."""
    a, b = vertices[one] - vertices[apex], vertices[other] - vertices[apex]
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("nx,nx->n", a, b)))


def _split_faces(faces: Ints, middle: Ints) -> Ints:
    """Split faces (F,3) at the middles (F,3) of their edges (corner i to the next): -1 where an edge stays whole."""
    count = (middle >= 0).sum(axis=1)
    parts = [faces[count == 0]]
    # Turned so that with one middle it is on the first edge, and with two the whole edge is the last.
    turn = np.where(count == 1, np.argmax(middle >= 0, axis=1), (np.argmax(middle < 0, axis=1) + 1) % 3)
    columns = (np.arange(3) + turn[:, None]) % 3
    faces, middle = np.take_along_axis(faces, columns, axis=1), np.take_along_axis(middle, columns, axis=1)
    a, b, c = faces.T
    ab, bc, ca = middle.T
    for which, triangles in (
        (count == 1, ((a, ab, c), (ab, b, c))),
        (count == 2, ((ab, b, bc), (a, ab, c), (ab, bc, c))),
        (count == 3, ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))),
    ):
        parts += [np.stack([corner[which] for corner in triangle], axis=1) for triangle in triangles]
    return np.concatenate(parts)


def _fair(mesh: Mesh, first: int) -> Floats:
    """Vertices (V,3), those from index `first` on moved to where the bilaplacian of the surface vanishes."""
    count = len(mesh.vertices)
    if first == count:
        return mesh.vertices
    moved = np.arange(count) >= first
    near = moved.copy()
    for _ in range(2):  # the bilaplacian of a vertex reaches two rings around it
        near[mesh.faces[near[mesh.faces].any(axis=1)]] = True
    index = np.flatnonzero(near)
    place = np.full(count, -1)
    place[index] = np.arange(len(index))
    ends = place[edges_of(mesh.faces[near[mesh.faces].all(axis=1)]).ends]
    laplacian = neighbour_laplacian(ends, len(index))
    bilaplacian = (laplacian @ laplacian).tocsr()
    free, fixed = moved[index], ~moved[index]
    right = -(bilaplacian[free][:, fixed] @ mesh.vertices[index[fixed]])
    vertices = mesh.vertices.copy()
    vertices[first:] = splu(bilaplacian[free][:, free].tocsc()).solve(right)
    return vertices
