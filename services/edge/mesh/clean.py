"""From an extracted mesh to one that can be shown: whole where there are points, ended where they end.

1. cut to a manifold, drop specks, close pin-holes       2. trim what no points back      3. smooth the cut borders
4. drop what the trimming left over, wind alike

Every length is in local spacings of the points (support.py), so the same numbers serve 1,000 and 1,000,000 points.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from services.edge.arrays import Bools, Floats, Ints, Tick, no_tick
from services.edge.mesh.band import part_of
from services.edge.mesh.clip import clip
from services.edge.mesh.holes import fill_holes, zip_tears
from services.edge.mesh.normals import face_normals, vertex_normals
from services.edge.mesh.nouns import Mesh
from services.edge.mesh.support import layer_spacing, overhang
from services.edge.mesh.topology import (
    border_edges,
    compact,
    edges_of,
    orient,
    pieces_of,
    to_manifold,
    vertex_pieces,
)

SPECK = 15.0  # squared spacings, so points: a piece with fewer is noise, not surface
PIN_HOLE = 12.0  # spacings around: no wider than 4; the trimming opens again what is a hole
AFTER = 0.9  # of the pin-hole's length once real holes are cut: the smallest of those are 11 spacings around
SEAM_ROUNDS, SEAM_STEP = 6, 0.7  # brings a ridge of a spacing's height down to the faces beside it
TEAR = 3.0  # spacings across: what lies further apart is not joined
OVERHANG = 0.25  # spacings: the alpha shape of random points ends about this much inside the true border
SMOOTH = ((0.5, -0.53),) * 5  # Taubin's pairs: take noise and the saw-teeth of borders off without shrinking

# A hole that touches no border is cut out only when it is too large to be chance, in squared spacings: the largest gap
# among 10,000 random points reached 10 on six closed surfaces.
HOLE = 12.0
KEPT = 1e-3  # spacings: the level of what is kept although it hangs over; only its sign matters


def clean(
    mesh: Mesh,
    near: Floats,
    *,
    speck: float = SPECK,
    pin_hole: float = PIN_HOLE,
    tear: float = TEAR,
    overhang_most: float = OVERHANG,
    tick: Tick = no_tick,
) -> Mesh:
    """Trim, mend and wind a mesh by the points (N,3) near it; both in one frame.

    speck in points; pin_hole, tear and overhang_most in local spacings. `tick` is called between the steps with the
    fraction done and may raise `Cancelled`. The result has no edge with more than two faces, is
    wound alike where that is possible, and is empty when nothing of the mesh is backed by points.
    """
    near = np.asarray(near, np.float64)
    tick(0)
    mesh = to_manifold(mesh)
    if len(mesh.faces) == 0:
        return compact(mesh)
    mesh = orient(mesh)
    tick(0.2)
    tree = cKDTree(near)
    spacing = layer_spacing(near, _normals_at(mesh, near), tree)
    mesh = _without_specks(mesh, spacing, tree, speck)
    mesh = orient(_mended(mesh, spacing, tree, pin_hole, tear))
    mesh = to_manifold(_trim(mesh, near, spacing, tree, overhang_most, part_of(tick, 0.4, 0.8)))
    tick(0.8)
    mesh = _mended(_without_specks(mesh, spacing, tree, speck), spacing, tree, AFTER * pin_hole, tear)
    mesh = orient(compact(_smooth(mesh)))
    tick(1)
    return mesh


def _mended(mesh: Mesh, spacing: Floats, tree: cKDTree, pin_hole: float, tear: float) -> Mesh:
    """The mesh without pin-holes and tears."""
    local = _spacing_at(mesh.vertices, spacing, tree)
    mesh = _settle_seams(mesh, zip_tears(fill_holes(mesh, pin_hole * local), tear * local))
    return fill_holes(mesh, pin_hole * _spacing_at(mesh.vertices, spacing, tree))


def _settle_seams(before: Mesh, after: Mesh) -> Mesh:
    """The mended mesh as a manifold, its former border vertices moved in between their neighbours.

    A border overshoots by up to a spacing, so a seam of two of them would stand up as a ridge.
    """
    seam = np.zeros(len(after.vertices), bool)
    seam[border_edges(before.faces)] = True
    seam[border_edges(after.faces)] = False
    ends = edges_of(after.faces).ends
    ends = np.concatenate([ends, ends[:, ::-1]])
    ends = ends[seam[ends[:, 0]]]
    vertices = after.vertices
    for _ in range(SEAM_ROUNDS):
        vertices = vertices + SEAM_STEP * _towards(vertices, ends)
    return to_manifold(Mesh(vertices, after.faces))


def _trim(mesh: Mesh, near: Floats, spacing: Floats, tree: cKDTree, most: float, tick: Tick) -> Mesh:
    """Cut off what hangs over the points by more than `most` spacings, and cut out holes."""
    border, hole = overhang(mesh.vertices, vertex_normals(mesh), near, spacing, tree, tick)
    border, hole = _averaged(mesh.faces, border - most, 2), _averaged(mesh.faces, hole, 2)
    areas = _areas(mesh) / np.square(_spacing_at(mesh.vertices, spacing, tree)[mesh.faces[:, 0]])
    outer, _ = _regions(mesh.faces, border > 0, areas)
    inner, area = _regions(mesh.faces, hole > 0, areas)
    level = np.where(outer | (border <= 0), border, -KEPT)
    return clip(mesh, np.where((hole > 0) & ~inner & (area >= HOLE), hole, level))


def _regions(faces: Ints, chosen: Bools, areas: Floats) -> tuple[Bools, Floats]:
    """Connected regions of chosen vertices: (V,) those whose region reaches a border, and (V,) their region's area."""
    corners = chosen[faces]
    region, count = vertex_pieces(faces[corners.all(axis=1)], len(chosen))
    some = np.flatnonzero(corners.any(axis=1))
    first = faces[some, np.argmax(corners[some], axis=1)]
    area = np.bincount(region[first], areas[some] * corners[some].mean(axis=1), count)
    at_border = np.zeros(count, bool)
    at_border[region[np.unique(border_edges(faces))]] = True
    return chosen & at_border[region], np.where(chosen, area[region], 0)


def _averaged(faces: Ints, values: Floats, times: int) -> Floats:
    """(V,) values, each with the mean over the faces around it, repeatedly: takes the scallops out of a level line."""
    uses = np.maximum(np.bincount(faces.ravel(), minlength=len(values)), 1)
    for _ in range(times):
        mean = np.repeat(values[faces].mean(axis=1), 3)
        values = np.bincount(faces.ravel(), mean, len(values)) / uses
    return values


def _without_specks(mesh: Mesh, spacing: Floats, tree: cKDTree, least: float) -> Mesh:
    """Drop pieces that could not hold `least` points; never the largest."""
    piece = pieces_of(mesh.faces)
    points = np.bincount(piece, _areas(mesh) / np.square(_spacing_at(mesh.vertices, spacing, tree)[mesh.faces[:, 0]]))
    kept: Bools = (points >= least) | (points == points.max(initial=0))
    return compact(mesh, np.flatnonzero(kept[piece]))


def _smooth(mesh: Mesh) -> Mesh:
    """Take the noise out: border vertices move along the border only, all others among all their neighbours."""
    border, edges = border_edges(mesh.faces), edges_of(mesh.faces).ends
    on_border = np.zeros(len(mesh.vertices), bool)
    on_border[border] = True
    ends = np.concatenate([border, edges[~on_border[edges[:, 0]]], edges[~on_border[edges[:, 1]]][:, ::-1]])
    ends = np.concatenate([ends, border[:, ::-1]])  # rows: a vertex, and a neighbour that it follows
    vertices = mesh.vertices
    for step in (share for pair in SMOOTH for share in pair):
        vertices = vertices + step * _towards(vertices, ends)
    return Mesh(vertices, mesh.faces)


def _towards(vertices: Floats, ends: Ints) -> Floats:
    """(V,3) from each vertex to the mean of those it follows; (L,2) rows of follower and followed."""
    count = np.bincount(ends[:, 0], minlength=len(vertices))[:, None]
    sums = [np.bincount(ends[:, 0], vertices[ends[:, 1], axis], len(vertices)) for axis in range(3)]
    return np.where(count > 0, np.stack(sums, axis=1) / np.maximum(count, 1) - vertices, 0)


def _areas(mesh: Mesh) -> Floats:
    """(F,) areas."""
    areas: Floats = np.linalg.norm(face_normals(mesh.vertices, mesh.faces), axis=1) / 2
    return areas


def _spacing_at(xyz: Floats, spacing: Floats, tree: cKDTree) -> Floats:
    """(M,) spacing of the nearest point."""
    at: Floats = spacing[tree.query(xyz, workers=-1)[1]]
    return at


def _normals_at(mesh: Mesh, near: Floats) -> Floats:
    """(N,3) normal of the nearest vertex to each point, sign arbitrary."""
    normals: Floats = vertex_normals(mesh)[cKDTree(mesh.vertices).query(near, workers=-1)[1]]
    return normals
