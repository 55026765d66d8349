"""Decide which places on a mesh are backed by points, in units of the points' own spacing.

Distance alone cannot decide: among 10,000 random points gaps of 1.7 spacings are common inside the surface, and the
same distance past the border is an overshoot. The difference is that inside, points lie all round. So a place is
unbacked when a disc of two spacings' radius without any points can be laid over it in the surface: the complement of
the points' alpha shape. Such a disc holds 12.6 points on average, so inside it is empty once in 300,000 places.

v a vertex, n its normal, s the spacing around it, R = 2 s
m(v) = max over discs that cover v of (distance from the disc's centre to the nearest point − R)
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bools, Floats, Ints, Tick, no_tick, part_of
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.parallel import in_threads, slices

DISC = 2.0  # R in spacings
HOLE_DISC = 1.5  # the largest empty one among 10,000 random points has 2.2, so holes must be weighed by area as well
NEIGHBOURS = 48  # of the nearest point: they reach 3.4 spacings from a vertex; farther points do not matter
# The discs' centres: (distance from v in R, number of directions). Those on the rim find borders, the others small
# holes. 22.5° apart on the rim, m is off by 0.02 R at most.
CENTRES = ((1.0, 16), (0.5, 8))
CHUNK = 2_048  # vertices at once: 48 neighbours × 4 B are 0.4 MB per array, so those in use stay in the cache
SOME = 16  # neighbours of the first, cheap test
LEAN = 0.15  # the mean of the neighbours leans 0.42 of their reach at a border; less than this is inside
LAYER = 0.5  # spacings off the tangent plane before a point is of another layer,
SLOPE = 1.0  # and this much more per distance along it: less would lose the points round a tight fold
FAR = np.float32(1e3)  # spacings: where a point of another layer is put, out of every disc
ROUND = 8  # nearest points of an isolated place
SPACING_NEIGHBOURS = 24  # give the spacing to within a tenth
# A chord between two points of one surface leans as much to one normal as to the other, even round a bend; one between
# two sheets leans alike to both, and at 45° lies in both cones. Counted in, such points made the spacing of sheets 1.4
# spacings apart a sixth too small, and cut holes there: 1,000 points on two sheets, Chamfer .00267 → .00256.
CHORD = 0.4  # of its length: how far a chord may leave the mean of the two tangent planes
# Where points suddenly become sparse, as past the end of a second scan, neither spacing fits at the step: the sparse
# side is full of discs that are empty by the dense side's spacing. There the dense side is thinned: at the step to the
# sparse spacing, further off to SLOW less per distance. Ratios below STEP are chance, or change so slowly that they do
# no harm.
SLOW, STEP = 0.05, 1.75
CELL = 1.4  # spacings: thinning keeps a point per cell of this side; smaller cells would keep too many
REACH = 64  # most rounds in which a spacing spreads to neighbours


class Support:
    """Measure how well the vertices of a mesh are backed by points. Vertices keep their numbers, new ones are appended.

    The cleaning moves vertices by less than a spacing, so the nearest point of a vertex is looked up only once.
    """

    def __init__(self, near: Floats, mesh: Mesh, normals: Floats, tick: Tick) -> None:
        """near (N,3) points; normals (V,3) of the mesh, sign arbitrary."""
        # Used once only, so quick to build rather than quick to query.
        mesh_tree = cKDTree(mesh.vertices, balanced_tree=False, compact_nodes=False)
        found = in_threads(lambda part: mesh_tree.query(near[part]), slices(len(near), CHUNK), part_of(tick, 0, 0.4))
        off, at = (np.concatenate(each) for each in zip(*found, strict=True))
        own = normals[at].astype(np.float32)
        away = self._index_points(near, own, part_of(tick, 0.4, 0.8))
        self._nearest_vertices = at[off < self._spacing]
        wide = self._spread_spacing(away, own)
        sudden = wide > STEP * self._spacing
        if sudden.any():
            kept = _thin(near, wide, sudden)
            self._index_points(near[kept], own[kept], no_tick)
        self._nearest = np.empty(0, np.int64)
        self._nearest_to(mesh.vertices)
        tick(1)

    def points_held(self, count: int) -> Ints:
        """Number (count,) of points that each vertex of the original mesh is nearest to, within a spacing."""
        return np.bincount(self._nearest_vertices, minlength=count)

    def spacing_at(self, vertices: Floats) -> Floats:
        """Spacing (V,) of the point nearest to each vertex."""
        return self._spacing[self._nearest_to(vertices)]

    def distance_from(self, vertices: Floats) -> Floats:
        """Distance (M,) of any places from the nearest point, in its spacings."""
        away, nearest = self._tree.query(vertices, workers=-1)
        distance: Floats = away / self._spacing[nearest]
        return distance

    def isolation(self, vertices: Floats) -> Floats:
        """Distance (V,) from the nearest point, in the widest spacing of the few points around; 0 within a spacing.

        Beside a sparse part the nearest point may belong to a dense one, whose spacing says nothing of the gap.
        """
        nearest = self._nearest_to(vertices)
        away = np.linalg.norm(vertices - self._near[nearest], axis=1)
        isolated = np.flatnonzero(away > self._spacing[nearest])
        distance, around = self._tree.query(vertices[isolated], k=min(ROUND, len(self._near)), workers=-1)
        alone = np.zeros(len(vertices))
        alone[isolated] = distance[:, 0] / self._spacing[around].max(axis=1)
        return alone

    def overhang(self, vertices: Floats, normals: Floats, tick: Tick) -> tuple[Floats, Floats]:
        """Overhang m(v) (V,) in spacings, for borders and for holes, clipped to [−1, 2]. normals (V,3), sign arbitrary.

        Borders count the points of the vertex's own layer, so that cloth may end above other cloth. Holes count all
        points and take a smaller disc, which finds holes of odd shapes too; `clean` judges them by area.
        """
        xyz, normals, nearest = vertices.astype(np.float32), normals.astype(np.float32), self._nearest_to(vertices)
        around = np.median(self._spacing[self._around[:, :8]], axis=1).astype(np.float32)
        doubtful = self._doubtful(xyz, normals, nearest, around)
        owners, owner = np.unique(nearest[doubtful], return_inverse=True)
        _, index = self._neighbours(owners, NEIGHBOURS, part_of(tick, 0, 0.3))
        columns = np.ascontiguousarray(self._near.T)
        border, hole = np.full(len(xyz), -1.0), np.full(len(xyz), -1.0)

        def look(part: slice) -> None:
            at = doubtful[part]
            rows = index[owner[part]].T
            relative = [columns[axis][rows] - xyz[at, axis] for axis in range(3)]
            x, y, own = _unroll(relative, normals[at].T, around[nearest[at]])
            hole[at] = _largest_empty(x, y, HOLE_DISC)
            border[at] = _largest_empty(np.where(own, x, FAR), y, DISC)

        in_threads(look, slices(len(doubtful), CHUNK), part_of(tick, 0.3, 1))
        return border, hole

    def _doubtful(self, xyz: Floats, normals: Floats, nearest: Ints, around: Floats) -> Ints:
        """Find by a cheap test the vertices that may not lie among points."""
        some = self._around[:, :SOME]
        mean = np.stack([self._near[:, axis][some].mean(axis=1) for axis in range(3)], axis=1)
        reach = np.linalg.norm(self._near[some[:, -1]] - self._near, axis=1)
        lean = mean[nearest] - xyz
        lean -= np.einsum("vx,vx->v", lean, normals)[:, None] * normals
        away = np.linalg.norm(self._near[nearest] - xyz, axis=1)
        return np.flatnonzero((np.linalg.norm(lean, axis=1) > LEAN * reach[nearest]) | (away > around[nearest]))

    def _neighbours(self, points: Ints, count: int, tick: Tick) -> tuple[Floats, Ints]:
        """Distances and numbers (M,K) of the nearest points of each of these points (M,), itself first."""
        count = min(count, len(self._near))
        away, index = np.empty((len(points), count), np.float32), np.empty((len(points), count), np.int32)

        def look(part: slice) -> None:
            away[part], index[part] = self._tree.query(self._tree.data[points[part]], k=count)

        in_threads(look, slices(len(points), CHUNK), tick)
        return away, index

    def _index_points(self, near: Floats, normals: Floats, tick: Tick) -> Floats:
        """Index the points (N,3), with normals (N,3): KD-tree, neighbours, spacing -> neighbours' distances (N,K)."""
        self._tree = cKDTree(near)
        self._near = near.astype(np.float32)
        away, self._around = self._neighbours(np.arange(len(near)), SPACING_NEIGHBOURS + 1, tick)
        self._spacing = self._layer_spacing(away, normals)
        return away

    def _layer_spacing(self, away: Floats, normals: Floats) -> Floats:
        """Spacing (N,) of the points within their own layer. normals (N,3) of the surface at the points."""
        reach, count = away[:, -1], away.shape[1]
        rows, normal = self._around.T, normals.T
        relative = [self._near[:, axis][rows] - self._near[:, axis] for axis in range(3)]
        rough = reach * np.float32(np.sqrt(np.pi / count))
        own = _own_layer(relative, normal, rough)
        others = [normals[:, axis][rows] for axis in range(3)]
        sign = np.where(_dot(others, normal) < 0, np.float32(-1), np.float32(1))
        off = np.abs(_dot(relative, normal) + sign * _dot(relative, others)) / 2
        own &= off < LAYER * rough + CHORD * away.T
        spacing = reach * np.sqrt(np.pi / np.maximum(own.sum(axis=0), 1))
        floored: Floats = np.maximum(spacing, 0.1 * float(np.median(spacing)))
        return floored

    def _spread_spacing(self, away: Floats, normals: Floats) -> Floats:
        """Spacing (N,) of each point, or if larger that of sparser points of its layer less SLOW times their distance.

        away (N,K) distances of the neighbours. The median around a point takes the place of its own spacing, so that a
        stray point, which is isolated too, has no effect.
        """
        sure = np.median(self._spacing[self._around[:, :8]], axis=1)
        wide, front = sure.copy(), np.arange(len(sure))
        for _ in range(REACH):
            neighbours, claim = self._around[front, 1:], wide[front, None] - SLOW * away[front, 1:]
            row, column = np.nonzero(claim > 1.05 * wide[neighbours])
            one, other, claim = front[row], neighbours[row, column], claim[row, column]
            between = self._near[other] - self._near[one]
            relative = [between[:, axis] for axis in range(3)]
            same = _own_layer(relative, normals[one].T, sure[one]) & _own_layer(relative, normals[other].T, sure[one])
            if not same.any():
                break
            np.maximum.at(wide, other[same], claim[same])
            front = np.unique(other[same])
        return wide

    def _nearest_to(self, vertices: Floats) -> Ints:
        """Index (V,) of the point nearest to each vertex, cached from the first position of the vertex."""
        new = vertices[len(self._nearest) :]
        if len(new):
            self._nearest = np.append(self._nearest, self._tree.query(new, workers=-1)[1])
        return self._nearest[: len(vertices)]


def _own_layer(relative: list[Floats], normals: Floats, spacing: Floats) -> Bools:
    """Mask (K,V) of points of the same layer: in a flat double cone around the tangent plane. relative 3 × (K,V)."""
    off = np.abs(_dot(relative, normals))
    along = np.sqrt(np.maximum(_dot(relative, relative) - np.square(off), 0))
    own: Bools = off < LAYER * spacing + SLOPE * along
    return own


def _thin(xyz: Floats, spacing: Floats, chosen: Bools) -> Ints:
    """Thin the chosen points to about this (N,) spacing -> indices of all points (N,3) that stay."""
    octave = np.floor(2 * np.log2(CELL * spacing[chosen])).astype(np.int64)
    cell = np.floor(xyz[chosen] / np.exp2(octave / 2)[:, None]).astype(np.int64)
    first = np.unique(np.column_stack([octave, cell]), axis=0, return_index=True)[1]
    kept: Ints = np.sort(np.concatenate([np.flatnonzero(~chosen), np.flatnonzero(chosen)[first]]))
    return kept


def _unroll(relative: list[Floats], normals: Floats, spacing: Floats) -> tuple[Floats, Floats, Bools]:
    """Flatten points around vertices, 3 × (K,V) -> x and y (K,V) in the tangent plane, in spacings; `_own_layer`.

    A point behind a crease keeps its distance in space, not that of its projection to the tangent plane.
    """
    across, up = _plane_axes(normals.T)
    x, y = _dot(relative, across.T), _dot(relative, up.T)
    squared = _dot(relative, relative)
    along = np.square(x) + np.square(y)
    own = np.sqrt(np.maximum(squared - along, 0)) < LAYER * spacing + SLOPE * np.sqrt(along)
    stretch = np.sqrt(squared / np.maximum(along, np.float32(1e-20))) / spacing
    return x * stretch, y * stretch, own


def _largest_empty(x: Floats, y: Floats, disc: float) -> Floats:
    """Compute m(v) for points (K,V) around V vertices, with discs of that radius."""
    squared = np.square(x) + np.square(y)
    most = np.zeros(x.shape[1], np.float32)
    for a, b in _centres(disc):
        away = (-2 * a) * x
        away += (-2 * b) * y
        away += squared
        np.maximum(most, away.min(axis=0) + (a * a + b * b), out=most)
    clipped: Floats = np.clip(np.sqrt(most) - disc, -1.0, 2.0)
    return clipped


def _centres(disc: float) -> Floats:
    """Centres (C,2), float32, of the discs of that radius."""
    rings = [(share * disc, np.arange(count) * (2 * np.pi / count)) for share, count in CENTRES]
    rows = [away * np.stack([np.cos(turn), np.sin(turn)], axis=1) for away, turn in rings]
    return np.concatenate(rows).astype(np.float32)


def _dot(vectors: list[Floats], others: list[Floats] | Floats) -> Floats:
    """Dot products of vectors given as three arrays of coordinates."""
    product: Floats = vectors[0] * others[0] + vectors[1] * others[1] + vectors[2] * others[2]
    return product


def _plane_axes(normals: Floats) -> tuple[Floats, Floats]:
    """Two unit vectors (V,3) at right angles to each normal and to each other."""
    least: Ints = np.argmin(np.abs(normals), axis=1)
    x = np.cross(normals, np.eye(3)[least])
    x /= np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-12)
    return x, np.cross(normals, x)
