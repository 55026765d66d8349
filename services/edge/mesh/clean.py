"""From an extracted mesh to one that can be shown: whole where there are points, ended where they end.

1. cut to a manifold, drop specks, close pin-holes       2. trim what no points back
3. drop what the trimming left over, mend again, wind alike      4. draw fins tight, smooth

Every length is in local spacings of the points (support.py), so the same numbers serve 1,000 and 1,000,000 points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array

from services.edge.arrays import Bools, Floats, Ints, Tick, no_tick
from services.edge.mesh.band import part_of
from services.edge.mesh.clip import clip
from services.edge.mesh.edges import border_edges, border_with, edges_of
from services.edge.mesh.holes import fill_holes, zip_tears
from services.edge.mesh.manifold import to_manifold
from services.edge.mesh.normals import face_normals, vertex_normals
from services.edge.mesh.nouns import Mesh
from services.edge.mesh.support import Support
from services.edge.mesh.topology import compact, orient, pieces_of, vertex_pieces

SPECK = 15.0  # squared spacings, so points: a piece with fewer is noise, not surface
PIN_HOLE = 12.0  # spacings around: no wider than 4; the trimming opens again what is a hole
AFTER = 0.9  # of the pin-hole's length once real holes are cut: the smallest of those are 11 spacings around
# Squared spacings that close a longer hole, a slit along a crease; then once real holes are cut, whose least has 10.
SLIT, SLIT_AFTER = 12.0, 8.0
SEAM_ROUNDS, SEAM_STEP = 6, 0.7  # brings a ridge of a spacing's height down to the faces beside it
TEAR = 3.0  # spacings across: what lies further apart is not joined
OVERHANG = 0.25  # spacings: the alpha shape of random points ends about this much inside the true border
# A fin, where the surfaces of a fold's two sides run past its crest, is drawn tight like a membrane. It lies off the
# points, and is sharp, or stands high over the membrane; a bend that the field curves over a gap is neither. T-shirt,
# normals: .920 with none drawn, .928 with all that lies .6 spacings off the points, .928 so; 1,000 points on a pleated
# skirt, Chamfer: .00275, .00280, .00275; dress, F(.005): .934, .932, .933.
OFF = 0.5  # spacings from the nearest point
SHARP, SHARP_ROUNDS = 0.05, 3  # 1 − the length of the mean normal, averaged so often: along an edge of 36° it is .05
HIGH = 0.3  # spacings over the membrane; .2 flattens pleats: their Chamfer .00241 → .00243
TIGHTEN_ROUNDS, TIGHTEN_STEP = 20, 0.7
SMOOTH = ((0.5, -0.53),) * 5  # Taubin's pairs: take noise and the saw-teeth of borders off without shrinking

# A hole that touches no border is cut out only when it is too large to be chance, in squared spacings: the largest gap
# among 10,000 random points reached 10 on six closed surfaces.
HOLE = 12.0
# A web that a field spins between two layers touches no border either, and points lie all round it. A disc of 1.3
# spacings' radius is empty at one of 200 random places, but such places do not add up to the room of two points.
WEB, DEEP, WEB_AREA = 1.0, 1.3, 2.0  # spacings from the points: where a web is cut, its middle; and the middle's area
KEPT = 1e-3  # spacings: the level of what is kept although it hangs over; only its sign matters


@dataclass(frozen=True, slots=True)
class Gaps:
    """What is mended: pin-holes and tears by length, in spacings, slits by area, in squared spacings."""

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
    tick: Tick = no_tick,
) -> Mesh:
    """Trim, mend and wind a mesh by the points (N,3) near it; both in one frame.

    speck in points; pin_hole, tear and overhang_most in local spacings. `tick` is called between the steps with the
    fraction done and may raise `Cancelled`. The result has no edge with more than two faces, is
    wound alike where that is possible, and is empty when nothing of the mesh is backed by points.
    """
    tick(0)
    mesh = to_manifold(mesh)
    if len(mesh.faces) == 0:
        return compact(mesh)
    tick(0.1)
    mesh = orient(mesh, part_of(tick, 0.1, 0.25))
    support = Support(np.asarray(near, np.float64), mesh, vertex_normals(mesh), part_of(tick, 0.25, 0.35))
    mesh, border = _without_specks(mesh, support, speck)
    mesh, border = _mended(mesh, border, support, Gaps(pin_hole, SLIT, tear), part_of(tick, 0.4, 0.5))
    mesh = _trimmed(mesh, border, support, overhang_most, part_of(tick, 0.5, 0.7))
    mesh, border = _without_specks(mesh, support, speck)
    mesh, _ = _mended(mesh, border, support, Gaps(AFTER * pin_hole, SLIT_AFTER, tear), part_of(tick, 0.75, 0.8))
    mesh, _ = _without_specks(mesh, support, speck)  # to mend may cut crumbs off
    mesh = orient(compact(mesh), part_of(tick, 0.8, 0.9))
    mesh = _tightened(mesh, support)
    tick(0.95)
    mesh = _smoothed(mesh)
    tick(1)
    return mesh


def _mended(mesh: Mesh, border: Ints, support: Support, gaps: Gaps, tick: Tick) -> tuple[Mesh, Ints]:
    """The mesh without such gaps, and what is left of its border."""
    tick(0)
    local = support.spacing_at(mesh.vertices)
    filled = fill_holes(mesh, gaps.pin_hole * local, border)
    left = border_with(border, filled.faces[len(mesh.faces) :])
    zipped = zip_tears(filled, gaps.tear * support.spacing_at(filled.vertices), left)
    left = border_with(left, zipped.faces[len(filled.faces) :])
    tick(0.4)
    mesh = _settled(zipped, border, left)
    tick(0.8)
    border = border_edges(mesh.faces)
    local = support.spacing_at(mesh.vertices)
    filled = fill_holes(mesh, gaps.pin_hole * local, border, largest=gaps.slit * np.square(local))
    return filled, border_with(border, filled.faces[len(mesh.faces) :])


def _settled(mesh: Mesh, before: Ints, after: Ints) -> Mesh:
    """The mesh as a manifold, its vertices that left the border moved in between their neighbours.

    A border overshoots by up to a spacing, so a seam of two of them would stand up as a ridge.
    """
    rim = _mask(before, len(mesh.vertices))
    seam = rim & ~_mask(after, len(mesh.vertices))
    ends = edges_of(mesh.faces[seam[mesh.faces].any(axis=1)]).ends
    ends = np.concatenate([ends, ends[:, ::-1]])
    vertices = _drawn(mesh.vertices, ends[seam[ends[:, 0]]], [SEAM_STEP] * SEAM_ROUNDS)
    return to_manifold(Mesh(vertices, mesh.faces), rim)


def _trimmed(mesh: Mesh, border: Ints, support: Support, most: float, tick: Tick) -> Mesh:
    """Cut off what hangs over the points by more than `most` spacings, and cut out holes."""
    tick(0)
    over, hole = support.overhang(mesh.vertices, vertex_normals(mesh), part_of(tick, 0.1, 0.8))
    over, hole = _averaged(mesh.faces, np.stack([over - most, hole], axis=1), 2).T
    areas = _points_on(mesh, support)
    rim = _mask(border, len(mesh.vertices))
    outer, _ = _regions(mesh.faces, over > 0, areas, rim)
    inner, area = _regions(mesh.faces, hole > 0, areas, rim)
    level = np.where(outer | (over <= 0), over, -KEPT)
    level = np.where((hole > 0) & ~inner & (area >= HOLE), hole, level)
    alone = support.loneliness(mesh.vertices)
    _, middle = _regions(mesh.faces, alone > WEB, areas * (alone > DEEP)[mesh.faces].mean(axis=1), rim)
    level = np.where(middle >= WEB_AREA, np.maximum(level, alone - WEB), level)
    tick(0.9)
    trimmed = clip(mesh, level)
    # Where faces are only taken away, every vertex between two fans is on the border.
    return to_manifold(trimmed, _mask(border_edges(trimmed.faces), len(trimmed.vertices)))


def _regions(faces: Ints, chosen: Bools, areas: Floats, rim: Bools) -> tuple[Bools, Floats]:
    """Connected regions of chosen vertices: (V,) those whose region reaches the rim, and (V,) their region's area."""
    corners = chosen[faces]
    some = np.flatnonzero(corners.any(axis=1))
    faces, corners = faces[some], corners[some]
    region, count = vertex_pieces(faces[corners.all(axis=1)], len(chosen))
    first = faces[np.arange(len(faces)), np.argmax(corners, axis=1)]
    area = np.bincount(region[first], areas[some] * corners.mean(axis=1), count)
    at_rim = np.zeros(count, bool)
    at_rim[region[rim]] = True
    return chosen & at_rim[region], np.where(chosen, area[region], 0)


def _averaged(faces: Ints, values: Floats, times: int) -> Floats:
    """(V,C) values, each with the mean over the faces around it, repeatedly: takes the scallops out of a level line."""
    weight = np.full(faces.size, 1 / 3)
    corners = csr_array((weight, faces.ravel(), np.arange(0, faces.size + 1, 3)), shape=(len(faces), len(values)))
    uses = np.maximum(np.bincount(faces.ravel(), minlength=len(values)), 1)[:, None]
    for _ in range(times):
        values = corners.T @ (corners @ values) * 3 / uses
    return values


def _without_specks(mesh: Mesh, support: Support, least: float) -> tuple[Mesh, Ints]:
    """The mesh without pieces that could not hold `least` points, the largest excepted, and its border.

    A leaf of few points among others is measured by spacings that reach across the gaps: it counts what it does hold.
    """
    edges = edges_of(mesh.faces)
    piece = pieces_of(mesh.faces, edges)
    points = np.bincount(piece, _points_on(mesh, support))
    of_vertex = np.zeros(len(mesh.vertices), np.int64)
    of_vertex[mesh.faces] = piece[:, None]
    in_use = _mask(mesh.faces, len(mesh.vertices))
    held = np.bincount(of_vertex[in_use], support.points_held(len(mesh.vertices))[in_use], len(points))
    points = np.maximum(points, held)
    kept: Bools = (points >= least) | (points == points.max(initial=0))
    mesh, border = Mesh(mesh.vertices, mesh.faces[kept[piece]]), edges.border(mesh.faces)
    return mesh, border[_mask(mesh.faces, len(mesh.vertices))[border].all(axis=1)]


def _tightened(mesh: Mesh, support: Support) -> Mesh:
    """Fins drawn tight between what lies around them. Border vertices stay."""
    ends = _steps_inside(mesh)
    off = support.distance_from(mesh.vertices) > OFF
    tight = _drawn(mesh.vertices, ends[off[ends[:, 0]]], [TIGHTEN_STEP] * TIGHTEN_ROUNDS)
    high = np.linalg.norm(tight - mesh.vertices, axis=1) > HIGH * support.spacing_at(mesh.vertices)
    fin = off & (high | (_sharpness(mesh) > SHARP))
    return Mesh(_drawn(mesh.vertices, ends[fin[ends[:, 0]]], [TIGHTEN_STEP] * TIGHTEN_ROUNDS), mesh.faces)


def _smoothed(mesh: Mesh) -> Mesh:
    """Noise taken out: border vertices move along the border only."""
    border = border_edges(mesh.faces)
    ends = np.concatenate([_steps_inside(mesh), border, border[:, ::-1]])
    return Mesh(_drawn(mesh.vertices, ends, [share for pair in SMOOTH for share in pair]), mesh.faces)


def _steps_inside(mesh: Mesh) -> Ints:
    """(L,2) a vertex that is not on the border, and each of its neighbours."""
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
    return _averaged(mesh.faces, sharpness[:, None], SHARP_ROUNDS)[:, 0]


def _drawn(vertices: Floats, ends: Ints, steps: Sequence[float]) -> Floats:
    """Vertices moved by each step's share of the way to the mean of those that they follow.

    ends (L,2): a vertex, and one that it follows; one that follows none stays.
    """
    moved, row = np.unique(ends[:, 0], return_inverse=True)
    count = np.bincount(row, minlength=len(moved))
    mean = coo_array((1 / count[row], (row, ends[:, 1])), shape=(len(moved), len(vertices))).tocsr()
    vertices = vertices.copy()
    for step in steps:
        vertices[moved] += step * (mean @ vertices - vertices[moved])
    return vertices


def _points_on(mesh: Mesh, support: Support) -> Floats:
    """(F,) how many points each face could hold: its area in squared spacings."""
    areas = np.linalg.norm(face_normals(mesh.vertices, mesh.faces), axis=1) / 2
    points: Floats = areas / np.square(support.spacing_at(mesh.vertices)[mesh.faces[:, 0]])
    return points


def _mask(chosen: Ints, count: int) -> Bools:
    """(count,) True at the chosen indices."""
    mask = np.zeros(count, bool)
    mask[chosen] = True
    return mask
