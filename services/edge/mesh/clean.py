"""Clean an extracted mesh for display: close it where there are points, trim it where they end.

1. cut to a manifold, drop specks, close pin-holes       2. trim what is not backed by points
3. drop specks, close gaps again, orient the faces       4. pull fins tight, smooth

Every length is in local spacings of the points (support.py), so the same numbers serve 1,000 and 1,000,000 points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array

from capture2vr.edge.arrays import Bools, Floats, Ints, Tick, no_tick, part_of
from capture2vr.edge.mesh.clip import clip_to_manifold
from capture2vr.edge.mesh.edges import border_edges, border_with, edges_of
from capture2vr.edge.mesh.holes import fill_holes, zip_tears
from capture2vr.edge.mesh.manifold import to_manifold
from capture2vr.edge.mesh.normals import face_normals, vertex_normals
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.pieces import without_collapsed
from capture2vr.edge.mesh.regions import average_over_faces, connected_regions
from capture2vr.edge.mesh.support import Support
from capture2vr.edge.mesh.topology import compact, orient, pieces_of

SPECK = 15.0  # squared spacings, so points: a piece with room for fewer is noise, not surface
PIN_HOLE = 12.0  # spacings: perimeter up to which holes are closed, no wider than 4; trimming reopens the real ones
AFTER = 0.9  # of that perimeter, after real holes are cut: the smallest of those are 11 spacings around
# Squared spacings: area up to which a longer hole, a slit along a crease, is closed; then, after real holes are cut, of
# which the smallest has 10.
SLIT, SLIT_AFTER = 12.0, 8.0
SEAM_ROUNDS, SEAM_STEP = 6, 0.7  # smoothing that brings a ridge of a spacing's height down to the faces beside it
TEAR = 3.0  # spacings: width up to which a tear is closed
OVERHANG = 0.25  # spacings: the alpha shape of random points ends about this much inside the true border
# A fin, where the surfaces of a fold's two sides run past its crest, is pulled tight like a membrane. It lies off the
# points, and is sharp, or stands high over the membrane; a bend that the field curves over a gap is neither. T-shirt,
# normals: .920 with none pulled, .928 with all that lies .6 spacings off the points, .928 so; 1,000 points on a pleated
# skirt, Chamfer: .00275, .00280, .00275; dress, F(.005): .934, .932, .933.
OFF = 0.5  # spacings from the nearest point
SHARP, SHARP_ROUNDS = 0.05, 3  # least `_sharpness` of a fin (.05 along an edge of 36°), and rounds of its averaging
HIGH = 0.3  # spacings over the membrane; .2 flattens pleats: their Chamfer .00241 → .00243
TIGHTEN_ROUNDS, TIGHTEN_STEP = 20, 0.7  # smoothing that makes the membrane
SMOOTH = ((0.5, -0.53),) * 5  # Taubin smoothing, in pairs of steps: removes noise and borders' saw-teeth, no shrinking

# A hole that touches no border is cut out only when it is too large to be chance, in squared spacings: the largest gap
# among 10,000 random points reached 10 on six closed surfaces.
HOLE = 12.0
# A web, a false surface between two layers, touches no border either, and points lie all round it. A disc of 1.3
# spacings' radius is empty at one of 200 random places, but such places do not add up to the area of two points.
WEB, DEEP, WEB_AREA = 1.0, 1.3, 2.0  # spacings from the points of a web's edge and of its middle; the middle's area
INSIDE = 1e-3  # spacings: minus this is the level of an overhang that stays; only the sign matters


@dataclass(frozen=True, slots=True)
class Gaps:
    """Largest gaps that are closed: pin-holes and tears by length, in spacings, slits by area, in squared spacings."""

    pin_hole: float
    slit: float
    tear: float


def clean(
    mesh: Mesh,
    near: Floats,
    *,
    speck: float = SPECK,
    pin_hole: float = PIN_HOLE,
    tear: float = TEAR,
    overhang_most: float = OVERHANG,
    specks: list[float] | None = None,
    tick: Tick = no_tick,
) -> Mesh:
    """Trim a mesh to the points (N,3) near it, close its gaps and orient its faces; both in one frame.

    specks gets the areas of the pieces that were dropped because they have room for fewer than `speck` points.
    speck in points; pin_hole, tear and overhang_most in local spacings. `tick` is called between the steps with the
    fraction done and may raise `Cancelled`. The result has no edge with more than two faces, is oriented
    consistently where that is possible, and is empty when no part of the mesh is backed by points.
    """
    tick(0)
    mesh = to_manifold(mesh)
    if len(mesh.faces) == 0:
        return compact(mesh)
    tick(0.1)
    mesh = orient(mesh, part_of(tick, 0.1, 0.25))
    support = Support(np.asarray(near, np.float64), mesh, vertex_normals(mesh), part_of(tick, 0.25, 0.35))
    dropped = [] if specks is None else specks
    mesh, border = _drop_specks(mesh, support, speck, dropped)
    mesh, border = _close_gaps(mesh, border, support, Gaps(pin_hole, SLIT, tear), part_of(tick, 0.4, 0.5))
    mesh = _trim(mesh, border, support, overhang_most, part_of(tick, 0.5, 0.7))
    mesh, border = _drop_specks(mesh, support, speck, dropped)
    mesh, _ = _close_gaps(mesh, border, support, Gaps(AFTER * pin_hole, SLIT_AFTER, tear), part_of(tick, 0.75, 0.8))
    mesh, _ = _drop_specks(mesh, support, speck, dropped)  # closing gaps may cut crumbs off
    mesh = orient(mesh, part_of(tick, 0.8, 0.9))
    mesh = _tighten_fins(mesh, support)
    tick(0.95)
    mesh = compact(without_collapsed(_smooth(mesh)))  # not before: the support knows vertices by their numbers
    tick(1)
    return mesh


def _close_gaps(mesh: Mesh, border: Ints, support: Support, gaps: Gaps, tick: Tick) -> tuple[Mesh, Ints]:
    """Close the gaps -> the mesh, and what is left of its border."""
    tick(0)
    local = support.spacing_at(mesh.vertices)
    filled = fill_holes(mesh, gaps.pin_hole * local, border)
    left = border_with(border, filled.faces[len(mesh.faces) :])
    zipped = zip_tears(filled, gaps.tear * support.spacing_at(filled.vertices), left)
    left = border_with(left, zipped.faces[len(filled.faces) :])
    tick(0.4)
    mesh = _flatten_seams(zipped, border, left)
    tick(0.8)
    border = border_edges(mesh.faces)
    local = support.spacing_at(mesh.vertices)
    filled = fill_holes(mesh, gaps.pin_hole * local, border, largest=gaps.slit * np.square(local))
    return filled, border_with(border, filled.faces[len(mesh.faces) :])


def _flatten_seams(mesh: Mesh, before: Ints, after: Ints) -> Mesh:
    """Move the vertices that left the border between their neighbours, and cut the mesh to a manifold.

    A border overshoots by up to a spacing, so a seam of two borders would stand up as a ridge.
    """
    rim = _mask(before, len(mesh.vertices))
    seam = rim & ~_mask(after, len(mesh.vertices))
    ends = edges_of(mesh.faces[seam[mesh.faces].any(axis=1)]).ends
    ends = np.concatenate([ends, ends[:, ::-1]])
    vertices = _move_to_neighbours(mesh.vertices, ends[seam[ends[:, 0]]], [SEAM_STEP] * SEAM_ROUNDS)
    return to_manifold(Mesh(vertices, mesh.faces), rim)


def _trim(mesh: Mesh, border: Ints, support: Support, most: float, tick: Tick) -> Mesh:
    """Cut off what hangs over the points by more than `most` spacings, and cut out holes and webs."""
    tick(0)
    over, hole = support.overhang(mesh.vertices, vertex_normals(mesh), part_of(tick, 0.1, 0.8))
    over, hole = average_over_faces(mesh.faces, np.stack([over - most, hole], axis=1), 2).T
    areas = _point_capacity(mesh, support)
    rim = _mask(border, len(mesh.vertices))
    outer, _ = connected_regions(mesh.faces, over > 0, areas, rim)
    inner, area = connected_regions(mesh.faces, hole > 0, areas, rim)
    level = np.where(outer | (over <= 0), over, -INSIDE)
    level = np.where((hole > 0) & ~inner & (area >= HOLE), hole, level)
    alone = support.isolation(mesh.vertices)
    _, middle = connected_regions(mesh.faces, alone > WEB, areas * (alone > DEEP)[mesh.faces].mean(axis=1), rim)
    level = np.where(middle >= WEB_AREA, np.maximum(level, alone - WEB), level)
    tick(0.9)
    return clip_to_manifold(mesh, level)


def _drop_specks(mesh: Mesh, support: Support, least: float, dropped: list[float]) -> tuple[Mesh, Ints]:
    """Drop pieces with room for fewer than `least` points, except the largest -> the mesh, and its border.

    `dropped` gets their areas.

    The spacing of a small piece among others (a leaf) spans the gaps around it, so the points that it holds count too.
    """
    edges = edges_of(mesh.faces)
    piece = pieces_of(mesh.faces, edges)
    points = np.bincount(piece, _point_capacity(mesh, support))
    of_vertex = np.zeros(len(mesh.vertices), np.int64)
    of_vertex[mesh.faces] = piece[:, None]
    in_use = _mask(mesh.faces, len(mesh.vertices))
    own = np.bincount(of_vertex[in_use], support.points_held(len(mesh.vertices))[in_use], len(points))
    points = np.maximum(points, own)
    kept: Bools = (points >= least) | (points == points.max(initial=0))
    areas = np.bincount(piece, np.linalg.norm(face_normals(mesh.vertices, mesh.faces), axis=1) / 2)
    dropped += areas[~kept].tolist()
    mesh, border = Mesh(mesh.vertices, mesh.faces[kept[piece]]), edges.border(mesh.faces)
    return mesh, border[_mask(mesh.faces, len(mesh.vertices))[border].all(axis=1)]


def _tighten_fins(mesh: Mesh, support: Support) -> Mesh:
    """Pull fins tight between the faces around them. Border vertices stay."""
    ends = _inner_links(mesh)
    off = support.distance_from(mesh.vertices) > OFF
    tight = _move_to_neighbours(mesh.vertices, ends[off[ends[:, 0]]], [TIGHTEN_STEP] * TIGHTEN_ROUNDS)
    high = np.linalg.norm(tight - mesh.vertices, axis=1) > HIGH * support.spacing_at(mesh.vertices)
    fin = off & (high | (_sharpness(mesh) > SHARP))
    return Mesh(_move_to_neighbours(mesh.vertices, ends[fin[ends[:, 0]]], [TIGHTEN_STEP] * TIGHTEN_ROUNDS), mesh.faces)


def _smooth(mesh: Mesh) -> Mesh:
    """Smooth the mesh; border vertices move along the border only."""
    border = border_edges(mesh.faces)
    ends = np.concatenate([_inner_links(mesh), border, border[:, ::-1]])
    return Mesh(_move_to_neighbours(mesh.vertices, ends, [share for pair in SMOOTH for share in pair]), mesh.faces)


def _inner_links(mesh: Mesh) -> Ints:
    """Pairs (L,2) of a vertex that is not on the border and one of its neighbours."""
    edges = edges_of(mesh.faces)
    rim = _mask(edges.border(mesh.faces), len(mesh.vertices))
    ends = np.concatenate([edges.ends, edges.ends[:, ::-1]])
    inside: Ints = ends[~rim[ends[:, 0]]]
    return inside


def _sharpness(mesh: Mesh) -> Floats:
    """(V,) how much the faces around each vertex differ in direction: 1 − the length of their mean unit normal."""
    normals = face_normals(mesh.vertices, mesh.faces)
    weight = np.repeat(np.column_stack([normals, np.linalg.norm(normals, axis=1)]), 3, axis=0)
    x, y, z, area = (np.bincount(mesh.faces.ravel(), column, len(mesh.vertices)) for column in weight.T)
    sharpness = 1 - np.sqrt(x * x + y * y + z * z) / np.maximum(area, 1e-30)
    return average_over_faces(mesh.faces, sharpness[:, None], SHARP_ROUNDS)[:, 0]


def _move_to_neighbours(vertices: Floats, ends: Ints, steps: Sequence[float]) -> Floats:
    """Laplacian smoothing: move vertices by each step's share of the way to the mean of their neighbours.

    ends (L,2): a vertex, and a neighbour that it follows; a vertex without any stays.
    """
    moved, row = np.unique(ends[:, 0], return_inverse=True)
    count = np.bincount(row, minlength=len(moved))
    mean = coo_array((1 / count[row], (row, ends[:, 1])), shape=(len(moved), len(vertices))).tocsr()
    vertices = vertices.copy()
    for step in steps:
        vertices[moved] += step * (mean @ vertices - vertices[moved])
    return vertices


def _point_capacity(mesh: Mesh, support: Support) -> Floats:
    """Number (F,) of points that each face has room for: its area in squared spacings."""
    areas = np.linalg.norm(face_normals(mesh.vertices, mesh.faces), axis=1) / 2
    points: Floats = areas / np.square(support.spacing_at(mesh.vertices)[mesh.faces[:, 0]])
    return points


def _mask(chosen: Ints, count: int) -> Bools:
    """(count,) True at the chosen indices."""
    mask = np.zeros(count, bool)
    mask[chosen] = True
    return mask
