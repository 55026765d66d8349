"""Join a tile's mesh to those of its neighbours: every face belongs to one tile, and border vertices coincide.

Tiles are welded one after the other, each to those before it. Both sides of a border computed the same surface, from
the same points on the same grid, but for the last bits, which may tip a decision of the cleaning here and there:

1. match   a vertex near the border with the one of the neighbour that it is: the nearest of each other
2. choose  a face belongs to the tile that its middle lies in, but not where a neighbour has it already
3. drop    faces that would be the third at an edge
4. fill    gaps that are left between the two sides, which are smaller than any hole that cleaning leaves open
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bools, Floats, Ints
from capture2vr.edge.mesh.concatenate import concatenate
from capture2vr.edge.mesh.edges import edges_of
from capture2vr.edge.mesh.holes import fill_holes
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.topology import compact, component_labels
from capture2vr.edge.tiles.grid import Tile, TileGrid

STRIP = 4.0
"""Cells around a tile in which its neighbours' faces are looked at."""
SEAM = 2.0
"""Cells from a tile's sides within which its border vertices belong to a seam."""
_SAME = 0.45  # cells: vertices are a cell apart, and the two sides' differ by 0.02 at most, but for a few
_GAP, _SLIT = 10.0, 8.0  # cells, and squared cells: less than the perimeter and the area of a hole that cleaning leaves


@dataclass(frozen=True, slots=True)
class _Joined:
    """The neighbours' strips with a tile's faces behind them: `first` of the vertices and `faces` are the strips'."""

    vertices: Floats
    strips: Ints
    faces: Ints


def strip_of(mesh: Mesh, grid: TileGrid, tile: Tile) -> Mesh:
    """Crop a mesh, in cells, to the faces that lie in a tile or in the overlap strip around it."""
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    return compact(mesh, np.flatnonzero(grid.within(middles, tile, STRIP)))


def weld(mesh: Mesh, grid: TileGrid, tile: Tile, beside: Sequence[Tile], before: Sequence[Mesh]) -> Mesh:
    """Join a tile's mesh to its neighbours'; all in cells.

    mesh    of the tile and a strip around it, as `mesh_tile` makes it
    beside  the neighbours that have points, in order
    before  strips of the neighbours that were welded before: their faces in and near this tile

    Returns the tile's own faces, with the neighbours' vertices where they meet.
    """
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    tiles = sorted([tile, *beside])
    owners = grid.keepers_of(middles, tiles)
    own = owners == tiles.index(tile)
    joined = _join(mesh, own, on_seam(mesh.vertices, grid, tile), before)
    kept = _without_third(joined, _drop_repeated(joined))
    pending = _later_edges(mesh, own, owners > tiles.index(tile), joined)
    whole = Mesh(joined.vertices, np.concatenate([joined.strips, joined.faces[kept]]))
    filled = fill_holes(
        whole,
        np.full(len(whole.vertices), _GAP),
        _gap_edges(whole, len(joined.strips), pending),
        largest=np.full(len(whole.vertices), _SLIT),
    )
    return compact(Mesh(filled.vertices, filled.faces[len(joined.strips) :]))


def on_seam(vertices: Floats, grid: TileGrid, tile: Tile) -> Bools:
    """Mask (V,) of places in cells that lie within SEAM of a tile's sides, or outside."""
    relative = vertices - grid.corner_of(tile)
    return np.asarray(((relative < SEAM) | (relative > grid.sides - SEAM)).any(axis=1))


def _join(mesh: Mesh, own: Bools, seam: Bools, before: Sequence[Mesh]) -> _Joined:
    """Number the neighbours' and the tile's vertices together: those that match have one number."""
    strips = [strip for strip in before if len(strip.faces)]
    if not strips:
        return _Joined(mesh.vertices, np.empty((0, 3), np.int64), mesh.faces[own])
    every = concatenate(strips)
    known, number = np.unique(every.vertices, axis=0, return_inverse=True)
    faces = number.ravel()[every.faces]
    faces = faces[np.unique(np.sort(faces, axis=1), axis=0, return_index=True)[1]]
    name = len(known) + np.arange(len(mesh.vertices))
    near = np.flatnonzero(seam)
    if len(near):
        away, other = cKDTree(known).query(mesh.vertices[near])
        back = cKDTree(mesh.vertices[near]).query(known)[1]
        same = (away < _SAME) & (back[other] == np.arange(len(near)))
        name[near[same]] = other[same]
    return _Joined(np.concatenate([known, mesh.vertices]), faces, name[mesh.faces[own]])


def _drop_repeated(joined: _Joined) -> Bools:
    """Mask (F,) of the tile's faces that no neighbour has, and that have three vertices."""
    both = np.sort(np.concatenate([joined.strips, joined.faces]), axis=1)
    _, first, which = np.unique(both, axis=0, return_index=True, return_inverse=True)
    is_first = first[which.ravel()] == np.arange(len(both))
    flat = (both[:, 1:] == both[:, :-1]).any(axis=1)
    kept: Bools = (is_first & ~flat)[len(joined.strips) :]
    return kept


def _without_third(joined: _Joined, kept: Bools) -> Bools:
    """Drop faces of the tile at edges of three or more, where a neighbour's face is among them."""
    kept = kept.copy()
    while True:
        rows = np.flatnonzero(kept)
        faces = np.concatenate([joined.strips, joined.faces[rows]])
        edges = edges_of(faces)
        crowded = np.flatnonzero(edges.size > 2)
        halves = [edges.order[edges.start[edge] : edges.start[edge] + edges.size[edge]] // 3 for edge in crowded]
        mixed = [each for each in halves if (each < len(joined.strips)).any()]
        extra = np.array([face - len(joined.strips) for each in mixed for face in each if face >= len(joined.strips)])
        if len(extra) == 0:
            return kept
        kept[rows[extra.astype(np.int64)]] = False


def _later_edges(mesh: Mesh, own: Bools, later: Bools, joined: _Joined) -> Ints:
    """Edges (L,2) of the tile's faces, in the joined numbers, behind which a tile goes on that is welded later."""
    edges = edges_of(mesh.faces)
    pairs = edges.halves(2)
    face = pairs // 3
    chosen = (own[face[:, 0]] & later[face[:, 1]]) | (own[face[:, 1]] & later[face[:, 0]])
    half = np.where(own[face[chosen, 0]], pairs[chosen, 0], pairs[chosen, 1])
    row = np.cumsum(own) - 1
    corner = half % 3
    named = joined.faces[row[half // 3]]
    index = np.arange(len(half))
    return np.sort(np.stack([named[index, corner], named[index, (corner + 1) % 3]], axis=1), axis=1)


def _gap_edges(whole: Mesh, strips: int, pending: Ints) -> Ints:
    """Border edges (B,2) of the loops that lie between the tile's faces and its neighbours'."""
    edges = edges_of(whole.faces)
    halves = edges.halves(1)[:, 0]
    ends = edges.ends[edges.size == 1]
    label = component_labels(ends, len(whole.vertices))
    degree = np.bincount(ends.ravel(), minlength=len(whole.vertices))
    piece = label[ends[:, 0]]
    mine = halves // 3 >= strips
    base = np.int64(len(whole.vertices))
    waits = np.isin(ends[:, 0] * base + ends[:, 1], pending[:, 0] * base + pending[:, 1])
    count = int(label.max(initial=-1)) + 1
    simple = np.bincount(piece, (degree[ends] != 2).any(axis=1), count) == 0
    both = (np.bincount(piece, mine, count) > 0) & (np.bincount(piece, ~mine, count) > 0)
    chosen = (simple & both & (np.bincount(piece, waits, count) == 0))[piece]
    return _directed(whole.faces, halves[chosen])


def _directed(faces: Ints, halves: Ints) -> Ints:
    """Edges (B,2) of half-edges (B,), as their faces walk them."""
    return np.stack([faces[halves // 3, halves % 3], faces[halves // 3, (halves % 3 + 1) % 3]], axis=1)
