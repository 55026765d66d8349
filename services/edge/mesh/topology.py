"""Which faces meet along which edges, and what follows: borders, pieces, winding, cutting to a manifold."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree

from services.edge.arrays import Bools, Floats, Ints
from services.edge.mesh.nouns import Mesh

# A vertex that is cut in two leaves two at one place. Each draws back by this share of the way into its own faces, so
# that a program which welds equal positions does not undo the cut.
DRAW_BACK = 0.02

BEND_STEPS = 64  # bends told apart when a tree of flattest neighbours is grown: 1.4° at a right angle


@dataclass(frozen=True, slots=True)
class Edges:
    """Undirected edges of F faces. A half-edge 3·f+i runs from corner i of face f to the next.

    order (3F,) half-edges sorted by edge; start, size (E,) the run of each edge in it; ends (E,2) its vertices, rising.
    """

    order: Ints
    start: Ints
    size: Ints
    ends: Ints

    def halves(self, size: int) -> Ints:
        """(K,size) half-edges of the edges with that many faces."""
        rows: Ints = self.order[self.start[self.size == size][:, None] + np.arange(size)]
        return rows


def edges_of(faces: Ints) -> Edges:
    """The edges of (F,3) faces."""
    ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    stride = int(faces.max(initial=0)) + 1
    keys = ends[:, 0] * stride + ends[:, 1]
    order = np.argsort(keys)
    start = np.flatnonzero(np.diff(keys[order], prepend=-1))
    return Edges(order, start, np.diff(np.append(start, len(order))), ends[order[start]])


def border_edges(faces: Ints) -> Ints:
    """(B,2) edges of one face, directed as that face walks them."""
    half = edges_of(faces).halves(1)[:, 0]
    return np.stack([faces.ravel()[half], faces.ravel()[_next(half)]], axis=1)


def border_loops(faces: Ints) -> list[Ints]:
    """The closed borders of a mesh whose border vertices have two border edges each, as vertices in order."""
    border = border_edges(faces)
    around: dict[int, list[int]] = {}
    for a, b in border.tolist():
        around.setdefault(a, []).append(b)
        around.setdefault(b, []).append(a)
    loops = []
    while around:
        start, (here, _) = around.popitem()
        loop, last = [start], start
        while here != start:
            loop.append(here)
            a, b = around.pop(here)
            here, last = (b if a == last else a), here
        loops.append(np.array(loop))
    return loops


def pieces_of(faces: Ints) -> Ints:
    """(F,) number of the connected piece of each face, where faces meet along edges."""
    return _labels(_adjacent(faces)[:, :2], len(faces))


def vertex_pieces(faces: Ints, count: int) -> tuple[Ints, int]:
    """(V,) number of the connected piece of each of `count` vertices, and how many pieces there are."""
    links = faces[:, [[0, 1], [1, 2]]].reshape(-1, 2)
    pieces = _labels(links, count)
    return pieces, int(pieces.max(initial=-1)) + 1


def compact(mesh: Mesh, kept: Ints | None = None) -> Mesh:
    """The mesh with the kept faces (a mask or indices; all by default) and only the vertices that they use."""
    faces = mesh.faces if kept is None else mesh.faces[kept]
    used, renamed = np.unique(faces, return_inverse=True)
    rgb = None if mesh.rgb is None else mesh.rgb[used]
    return Mesh(mesh.vertices[used], renamed.reshape(-1, 3), rgb)


def orient(mesh: Mesh) -> Mesh:
    """Wind neighbours alike, closed pieces outwards. A piece that no winding suits (Möbius) keeps one seam of flips."""
    adjacent = _adjacent(mesh.faces)
    flip = _flips(adjacent, _bends(mesh, adjacent), len(mesh.faces))
    faces = np.where(flip[:, None], mesh.faces[:, ::-1], mesh.faces)
    piece = _labels(adjacent[:, :2], len(faces))
    corners = mesh.vertices[faces]
    volume = np.bincount(piece, np.einsum("fx,fx->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])))
    edges = edges_of(faces)
    is_open = np.zeros(len(volume), bool)
    is_open[piece[edges.halves(1)[:, 0] // 3]] = True
    inward = (volume < 0) & ~is_open
    return Mesh(mesh.vertices, np.where(inward[piece][:, None], faces[:, ::-1], faces), mesh.rgb)


def to_manifold(mesh: Mesh) -> Mesh:
    """Cut the mesh where more than two faces share an edge, or more than one fan of faces a vertex. No face is lost."""
    faces = mesh.faces[(mesh.faces != np.roll(mesh.faces, 1, axis=1)).all(axis=1)]
    edges = edges_of(faces)
    sheets = [sheet for at_edge in _sheets(mesh.vertices, faces, edges) for sheet in at_edge if len(sheet) == 2]
    mesh = _cut(mesh.vertices, faces, np.concatenate([edges.halves(2), *(sheet[None] for sheet in sheets)]))
    while doubled := _doubled(mesh):
        mesh = _with_midpoints(mesh, doubled)
    return mesh


def _next(half: Ints) -> Ints:
    """The half-edge after this one in its face."""
    return half - half % 3 + (half + 1) % 3


def _labels(links: Ints, count: int) -> Ints:
    graph = coo_array((np.ones(len(links), np.int8), (links[:, 0], links[:, 1])), shape=(count, count))
    labels: Ints = connected_components(graph, directed=False)[1].astype(np.int64)
    return labels


def _adjacent(faces: Ints) -> Ints:
    """(K,3) two faces that share an edge of two, and 1 where they wind against each other."""
    half = edges_of(faces).halves(2)
    return np.column_stack([half // 3, faces.ravel()[half[:, 0]] == faces.ravel()[half[:, 1]]])


def _bends(mesh: Mesh, adjacent: Ints) -> Floats:
    """(K,) 1 − cos of the angle between two faces, whatever their windings: 0 flat, 2 folded shut."""
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-18)
    cos = np.einsum("kx,kx->k", normals[adjacent[:, 0]], normals[adjacent[:, 1]])
    bend: Floats = np.maximum(1 - np.where(adjacent[:, 2], -cos, cos), 0)
    return bend


def _flips(adjacent: Ints, bend: Floats, count: int) -> Bools:
    """(F,) faces to turn over so that neighbours agree along the flattest spanning tree: seams follow sharp bends."""
    piece = _labels(adjacent[:, :2], count)
    root = np.unique(piece, return_index=True)[1]
    # One more node joins the roots, so that a single walk reaches every piece.
    rows = np.concatenate([adjacent[:, 0], np.full(len(root), count)])
    columns = np.concatenate([adjacent[:, 1], root])
    # The weight carries the winding through the tree: whole numbers for the bend, a half where the faces disagree.
    weight = 1 + np.floor(BEND_STEPS * np.append(bend, np.zeros(len(root))))
    weight[: len(adjacent)] += 0.5 * adjacent[:, 2]
    graph = coo_array((weight, (rows, columns)), shape=(count + 1, count + 1)).tocsr()
    tree = minimum_spanning_tree(graph)
    tree = (tree + tree.T).tocsr()
    parent = breadth_first_order(tree, count, directed=True)[1].astype(np.int64)
    parent[count] = count
    nodes = np.arange(count)
    flip = np.append(np.asarray(tree[nodes, parent[:count]]).ravel() % 1 > 0, False)
    while (parent != count).any():  # pointer doubling: every step halves the way to the root
        flip ^= flip[parent]
        parent = parent[parent]
    return flip[:count]


def _sheets(vertices: Floats, faces: Ints, edges: Edges) -> Iterator[list[Ints]]:
    """Edges of more than two faces: their half-edges, in the pairs that go on straightest, then what is left alone."""
    for start, size in zip(edges.start[edges.size > 2], edges.size[edges.size > 2], strict=True):
        half = edges.order[start : start + size]
        a, b, c = (vertices[faces.ravel()[h]] for h in (half, _next(half), _next(_next(half))))
        along = (b - a) / max(float(np.linalg.norm(b[0] - a[0])), 1e-18)
        side = c - a - np.einsum("hx,hx->h", c - a, along)[:, None] * along
        side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-18)
        cos = side @ side.T + 4 * np.tri(size)
        sheets, alone = [], set(range(size))
        for _ in range(size // 2):
            i, j = np.unravel_index(np.argmin(cos), cos.shape)
            sheets.append(half[[i, j]])
            alone -= {int(i), int(j)}
            cos[[i, j]] = cos[:, [i, j]] = 4
        yield sheets + [half[[i]] for i in alone]


def _cut(vertices: Floats, faces: Ints, pairs: Ints) -> Mesh:
    """Faces joined along the (K,2) pairs of half-edges and nowhere else."""
    a, b = pairs.T
    same = faces.ravel()[a] == faces.ravel()[b]
    partner_start, partner_end = np.where(same, b, _next(b)), np.where(same, _next(b), b)
    links = np.concatenate([np.stack([a, partner_start], 1), np.stack([_next(a), partner_end], 1)])
    corner = _labels(links, faces.size)
    origin = np.empty(int(corner.max(initial=-1)) + 1, np.int64)
    origin[corner] = faces.ravel()
    placed = vertices[origin]
    split = np.flatnonzero(np.bincount(origin, minlength=len(vertices))[origin] > 1)
    if len(split):
        owner = np.repeat(np.arange(len(faces)), 3)
        centre = vertices[faces].mean(axis=1)[owner]
        count = np.bincount(corner)
        mean = np.stack([np.bincount(corner, centre[:, axis]) for axis in range(3)], axis=1) / count[:, None]
        placed[split] += DRAW_BACK * (mean[split] - placed[split])
    return Mesh(placed, corner.reshape(-1, 3))


def _doubled(mesh: Mesh) -> list[Ints]:
    """Where sheets pass through the same two vertices, the half-edges of all sheets but the first. Each face once."""
    busy, doubled = set[int](), []
    for sheets in _sheets(mesh.vertices, mesh.faces, edges_of(mesh.faces)):
        for sheet in sheets[1:]:
            touched = set((sheet // 3).tolist())
            if not touched & busy:
                busy |= touched
                doubled.append(sheet)
    return doubled


def _with_midpoints(mesh: Mesh, sheets: list[Ints]) -> Mesh:
    """Give each sheet a vertex of its own in the middle of the edge of its half-edges."""
    faces, half = mesh.faces, np.concatenate(sheets)
    one = np.array([sheet[0] for sheet in sheets])
    middle = mesh.vertices[faces.ravel()[np.stack([one, _next(one)])]].mean(axis=0)
    new = np.repeat(len(mesh.vertices) + np.arange(len(sheets)), [len(sheet) for sheet in sheets])
    first, second = faces[half // 3], faces[half // 3]
    rows = np.arange(len(half))
    first[rows, (half % 3 + 1) % 3] = new
    second[rows, half % 3] = new
    kept = np.delete(faces, half // 3, axis=0)
    return Mesh(np.concatenate([mesh.vertices, middle]), np.concatenate([kept, first, second]))
