"""Connected pieces of a mesh, and the orientation (winding) of its faces."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bools, Floats, Ints, Tick, no_tick
from capture2vr.edge.mesh.edges import Edges, edges_of
from capture2vr.edge.mesh.normals import face_normals
from capture2vr.edge.mesh.nouns import Mesh

_ASKED = 2_000  # faces of each piece that tell which way it faces
_HOLLOW = 0.01
"""Least volume between a piece and its middle, of the root of its area cubed, for it to have an inside. A ball has .09,
a tube three times as long as wide .05."""
BEND_STEPS = 64  # distinct bends in the spanning tree of flattest neighbours: steps of 1.4° at a right angle


def component_labels(links: Ints, count: int) -> Ints:
    """Number (count,) of the connected component of each node, for links (L,2) between nodes."""
    ends = links.astype(np.int32 if count < 2**31 else np.int64)
    graph = coo_array((np.ones(len(links), np.int8), (ends[:, 0], ends[:, 1])), shape=(count, count))
    pieces: Ints = connected_components(graph, directed=False)[1].astype(np.int64)
    return pieces


def component_count(edges: Ints) -> int:
    """Number of connected components of the edges (E,2); vertices without an edge do not count."""
    used, ends = np.unique(edges, return_inverse=True)
    return int(component_labels(ends.reshape(-1, 2), len(used)).max(initial=-1)) + 1


def pieces_of(faces: Ints, edges: Edges | None = None) -> Ints:
    """Number (F,) of the connected piece of each face; faces are connected along edges of two faces."""
    return component_labels((edges or edges_of(faces)).halves(2) // 3, len(faces))


def vertex_pieces(faces: Ints, count: int) -> tuple[Ints, int]:
    """Number (V,) of the connected piece of each of `count` vertices, and how many pieces there are."""
    pieces = component_labels(faces[:, [[0, 1], [1, 2]]].reshape(-1, 2), count)
    return pieces, int(pieces.max(initial=-1)) + 1


def compact(mesh: Mesh, kept: Ints | None = None) -> Mesh:
    """Drop all but the kept faces (a mask or indices; all by default), and the vertices that no face uses."""
    faces = mesh.faces if kept is None else mesh.faces[kept]
    used = np.zeros(len(mesh.vertices), bool)
    used[faces] = True
    return mesh.with_vertices(used, (np.cumsum(used) - 1)[faces])


def orient(mesh: Mesh, tick: Tick = no_tick) -> Mesh:
    """Orient faces consistently, closed and hollow pieces outwards. A non-orientable piece (Möbius) keeps one seam.

    `tick` is called in between: a million faces take more than a second.
    """
    flip = _flips(mesh, tick)
    return Mesh(mesh.vertices, np.where(flip[:, None], mesh.faces[:, ::-1], mesh.faces), mesh.rgb)


def turned(mesh: Mesh, piece: Ints, towards: Floats) -> Mesh:
    """Turn over the pieces most of which face the wrong way.

    piece    (F,) the number of each face's
    towards  (F,) how much of each face is known to be the right way, below 0 where it is the wrong one
    """
    flip = (np.bincount(piece, towards) < 0)[piece]
    return Mesh(mesh.vertices, np.where(flip[:, None], mesh.faces[:, ::-1], mesh.faces), mesh.rgb)


def facing_as(mesh: Mesh, other: Mesh) -> Mesh:
    """Turn the pieces of a mesh over that face another way than the surface of the other mesh that is nearest to them.

    Simplified to other triangles, a surface keeps its front that way, whatever its volume says.
    """
    piece = pieces_of(mesh.faces)
    asked = some_of_each(piece)
    corners = mesh.faces[asked]
    tree = cKDTree(other.vertices[other.faces].mean(axis=1), balanced_tree=False)
    near = tree.query(mesh.vertices[corners].mean(axis=1), workers=-1)[1]
    normals = face_normals(mesh.vertices, corners), face_normals(other.vertices, other.faces[near])
    alike = np.zeros(len(piece))
    alike[asked] = np.einsum("fx,fx->f", *normals)
    return turned(mesh, piece, alike)


def some_of_each(piece: Ints) -> Ints:
    """Draw faces of each piece (F,) at random, all of a small one: a majority needs no more."""
    drawn = np.random.default_rng(0).permutation(len(piece))
    drawn = drawn[np.argsort(piece[drawn], kind="stable")]
    start = np.searchsorted(piece[drawn], np.arange(piece.max(initial=-1) + 1))
    some: Ints = drawn[np.arange(len(drawn)) - start[piece[drawn]] < _ASKED]
    return some


def reseamed(mesh: Mesh) -> Mesh:
    """Move the seams of non-orientable pieces, where neighbours disagree, to other places; orient all other pieces.

    An algorithm that works edge by edge cannot work along seams; in two steps with different seams, it can.
    """
    flip = _flips(mesh, no_tick, elsewhere=True)
    return Mesh(mesh.vertices, np.where(flip[:, None], mesh.faces[:, ::-1], mesh.faces), mesh.rgb)


def seam_length(faces: Ints) -> int:
    """Number of edges at which neighbours are wound against each other."""
    return int(_against(faces, edges_of(faces)).sum())


def _against(faces: Ints, edges: Edges) -> Bools:
    """Mask (K,) of edges of two whose faces are wound against each other."""
    half = edges.halves(2)
    against: Bools = faces.ravel()[half[:, 0]] == faces.ravel()[half[:, 1]]
    return against


def _flips(mesh: Mesh, tick: Tick, *, elsewhere: bool = False) -> Bools:
    """Mask (F,) of the faces to flip. elsewhere: no seam stays where it is."""
    tick(0)
    edges, count = edges_of(mesh.faces), len(mesh.faces)
    tick(0.2)
    against = _against(mesh.faces, edges)
    adjacent = edges.halves(2) // 3
    # Every face twice, as it is and flipped, joined where windings agree: a piece falls in two, or is one-sided.
    straight = np.column_stack([adjacent[:, 0], adjacent[:, 1] + count * against])
    turned = np.column_stack([adjacent[:, 0] + count, adjacent[:, 1] + count * ~against])
    as_is, over = component_labels(np.concatenate([straight, turned]), 2 * count).reshape(2, -1)
    piece, flip = np.minimum(as_is, over), as_is > over
    one_sided = as_is == over
    tick(0.5)
    if one_sided.any():
        flip[one_sided] = _flips_along_flattest_tree(mesh, adjacent, against, one_sided, elsewhere=elsewhere)
    tick(0.8)
    flip = flip ^ _inward(mesh, flip, piece)[piece]
    tick(1)
    return flip


def _inward(mesh: Mesh, flip: Bools, piece: Ints) -> Bools:
    """Mask (P,) of pieces that are wound to be seen from inside after the flips: closed ones, and hollow open ones such
    as a bowl, by the volume between them and their middle. A flat sheet has no inside."""
    normals, first = face_normals(mesh.vertices, mesh.faces), mesh.vertices[mesh.faces[:, 0]]
    areas = np.linalg.norm(normals, axis=1) / 2
    area = np.maximum(np.bincount(piece, areas), 1e-300)
    middle = np.stack([np.bincount(piece, areas * column) for column in first.T], axis=1) / area[:, None]
    height = np.einsum("fx,fx->f", first - middle[piece], normals)
    volume = np.bincount(piece, np.where(flip, -height, height)) / 6
    inward: Bools = volume < -_HOLLOW * area**1.5
    return inward


def _flips_along_flattest_tree(mesh: Mesh, adjacent: Ints, against: Bools, chosen: Bools, *, elsewhere: bool) -> Bools:
    """Mask of the chosen faces to flip so that neighbours agree along the flattest spanning tree: seams follow bends.

    elsewhere: the tree first joins faces that are wound against each other now.
    """
    count = int(chosen.sum())
    name = np.cumsum(chosen) - 1
    inside = chosen[adjacent[:, 0]]
    against, links = against[inside], name[adjacent[inside]]
    bend = _bends(mesh.vertices, mesh.faces[chosen], links, against)
    root = np.unique(component_labels(links, count), return_index=True)[1]
    # One more node joins the roots, so that a single walk reaches every piece.
    rows = np.concatenate([links[:, 0], np.full(len(root), count)]).astype(np.int32)
    columns = np.concatenate([links[:, 1], root]).astype(np.int32)
    # The weight carries the winding through the tree: whole numbers for the bend, a half where the faces disagree.
    if elsewhere:
        bend = np.where(against, 0, bend + 1)
    weight = 1 + np.floor(BEND_STEPS * np.append(bend, np.zeros(len(root))))
    weight[: len(links)] += 0.5 * against
    tree = minimum_spanning_tree(coo_array((weight, (rows, columns)), shape=(count + 1, count + 1)).tocsr())
    tree = (tree + tree.T).tocsr()
    parent = breadth_first_order(tree, count, directed=True)[1].astype(np.int64)
    parent[count] = count
    nodes = np.arange(count)
    flip = np.append(np.asarray(tree[nodes, parent[:count]]).ravel() % 1 > 0, False)
    while (parent != count).any():  # pointer doubling: every step halves the way to the root
        flip ^= flip[parent]
        parent = parent[parent]
    return flip[:count]


def _bends(vertices: Floats, faces: Ints, adjacent: Ints, against: Bools) -> Floats:
    """Bend (K,), 1 − cos of the angle between two faces, whatever their windings: 0 flat, 2 folded shut."""
    normals = face_normals(vertices, faces)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-18)
    cos = np.einsum("kx,kx->k", normals[adjacent[:, 0]], normals[adjacent[:, 1]])
    bend: Floats = np.maximum(1 - np.where(against, -cos, cos), 0)
    return bend
