"""Fit a closed surface to oriented points, smooth where there are none, and out of what is known to be free space.

p, n, w  a point, its normal out of the surface, and its weight
e        three quarters of a cell
φ        on the nodes of a grid: the signed distance to the surface in cells, positive outside

φ minimises  Σ w (4 φ(p)² + (φ(p + e n) − ¾)² + (φ(p − e n) + ¾)²) + λ Σ (Δφ)²   with φ ≥ b where space is free,

b being above 0, and the depth below the plane that the thing stands on. The bilaplacian goes on with a surface's
bend over a gap, where a membrane (Poisson's equation) would fall in: of a banana half of which has no depth the other
half remained. The bounds are held by penalties on the nodes that violate them (an active set), from a coarse grid to a
fine one; of the fine one only what is near the surface, or unknown, is solved.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_erosion, binary_fill_holes, map_coordinates, uniform_filter
from scipy.sparse import coo_array, csr_array, diags_array, vstack
from scipy.sparse.linalg import cg
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bools, Floats, Ints, Tick, no_tick
from capture2vr.edge.closing.oriented_points import OrientedPoints
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.points.plane import Plane

_MARGIN = 0.08
"""Room around the points, of their longest side: what a bend may go on over."""
_HANGS = 0.3
"""Height over the plane, of the longest side, from which on a thing hangs, and nothing of it reaches down."""
_OFFSET = 0.75  # e, in cells
_SMOOTH = 0.2  # λ
_OUTSIDE, _FAR_OUTSIDE = 0.6, 2.0
"""Least φ of free space, and of the grid's border."""
_FREE_DEEP = 2
"""Cells inside free space from which on φ is not solved for."""
_ON_POINTS = 1.2
"""Cells from a point within which free space does not count: its border is known to within a cell."""
_PENALTY, _INERTIA = 4.0, 1e-5
"""Weights of the penalties, and of nodes that nothing else determines."""
_ROUNDS, _EXACT = 4, 1e-3
"""Rounds of the active set, and the relative residual that ends each."""
_STEPS, _WORK = 60, 6_000_000
"""Least steps of conjugate gradients in a round, and steps times nodes that a small grid may take."""
_ENOUGH = 3.0
"""Points in half a cell whose weight is not less than that of more."""
_RISES, _ONE_SIDED = 0.2, 0.5
"""Rise of φ along a point's normal, over half a cell to both sides, below which the normal is wrong; of a right one it
is 1. Only where the mean normal around has at least this length: to both sides of a thin wall normals are opposite.
The folds that wrong ones make of a smooth surface are pits."""
_CREASE = 2.0
"""Cells over the plane below which that is not asked: points of the ground, with normals that point up, tell there
where the thing ends. Without them a boulder bulged onto its slab, and the statue's PSNR fell from 28.7 to 28.0 dB."""

IsFree = Callable[[Floats], Bools]
"""Function from places (N,3) to a mask (N,) of those in free space."""


@dataclass(frozen=True, slots=True)
class SolidGrid:
    """Nodes of a grid: low (3,) the first one's place, side of a cell, and the number of nodes along each axis."""

    low: Floats
    side: float
    shape: tuple[int, int, int]

    @classmethod
    def around(cls, xyz: Floats, support: Plane | None, cells: int) -> SolidGrid:
        """Lay a grid around points (N,3), with so many cells along their longest side, and down to a plane below."""
        low, high = xyz.min(axis=0), xyz.max(axis=0)
        longest = float((high - low).max())
        if support is not None and (height := support.height(xyz)).min() < _HANGS * longest:
            feet = xyz - height[:, None] * support.normal
            low, high = np.minimum(low, feet.min(axis=0)), np.maximum(high, feet.max(axis=0))
        low, high, side = low - _MARGIN * longest, high + _MARGIN * longest, longest / cells
        x, y, z = (int(number) for number in np.ceil((high - low) / side).astype(int) + 1)
        return cls(low, side, (x, y, z))

    def nodes(self) -> Floats:
        """Places (X·Y·Z,3) of the nodes."""
        axes = [start + self.side * np.arange(count) for start, count in zip(self.low, self.shape, strict=True)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)

    def border(self) -> Bools:
        """Mask (X·Y·Z,) of the outermost nodes."""
        border = np.ones(self.shape, bool)
        border[1:-1, 1:-1, 1:-1] = False
        return border.ravel()


@dataclass(frozen=True, slots=True)
class _Solved:
    """φ (X,Y,Z) on a grid, and what of it is free space, (X,Y,Z)."""

    grid: SolidGrid
    phi: Floats
    free: Bools

    def at(self, places: Floats) -> Floats:
        """Interpolate φ at places (N,3), in cells of this grid."""
        return np.asarray(map_coordinates(self.phi, self._index(places).T, order=1, mode="nearest"))

    def contradicts(self, points: OrientedPoints, support: Plane | None) -> Bools:
        """(N,) whether φ does not rise along a point's normal, where most normals around point the same way, and which
        lies well over the plane that the thing stands on."""
        half = 0.5 * self.grid.side * points.normal
        rise = self.at(points.xyz + half) - self.at(points.xyz - half)
        node = np.ravel_multi_index(tuple(np.rint(self._index(points.xyz)).astype(np.int64).T), self.grid.shape)
        *normal, weight = (
            uniform_filter(np.bincount(node, each, self.phi.size).reshape(self.grid.shape), 3).ravel()[node]
            for each in (*(points.weight * column for column in points.normal.T), points.weight)
        )
        one_sided = np.linalg.norm(normal, axis=0) > _ONE_SIDED * weight
        wrong: Bools = (rise < _RISES) & one_sided
        return wrong if support is None else wrong & (support.height(points.xyz) > _CREASE * self.grid.side)

    def is_surely_free(self, places: Floats) -> Bools:
        """(N,) whether all nodes around places (N,3) are free."""
        low = np.clip(np.floor(self._index(places)).astype(np.int64), 0, np.array(self.grid.shape) - 2)
        sure = np.ones(len(places), bool)
        for corner in np.ndindex(2, 2, 2):
            sure &= self.free[tuple((low + corner).T)]
        return sure

    def _index(self, places: Floats) -> Floats:
        index: Floats = (places - self.grid.low) / self.grid.side
        return index


def fit_solid(
    points: OrientedPoints,
    is_free: IsFree,
    support: Plane | None,
    cells: Sequence[int],
    tick: Tick = no_tick,
) -> Mesh:
    """Fit a closed surface to points, with faces that are wound to be seen from outside; none where all is free space.

    support  the plane that the thing stands on, with its normal to the thing
    cells    along the longest side of each grid, each twice as fine as the one before
    """
    from skimage.measure import marching_cubes

    solved: _Solved | None = None
    for number, count in enumerate(cells):
        if solved is not None:
            points = points.subset(~solved.contradicts(points, support))
        solved = _solve(points, is_free, support, SolidGrid.around(points.xyz, support, count), solved)
        tick((number + 1) / len(cells))
    if solved is None or solved.phi.min() >= 0:  # sheets, both sides of which are free
        return Mesh(np.empty((0, 3)), np.empty((0, 3), np.int64))
    cavities = binary_fill_holes(solved.phi < 0) & (solved.phi >= 0)  # nobody can have seen any
    vertices, faces, _, _ = marching_cubes(np.where(cavities, -_OUTSIDE, solved.phi), 0.0)  # type: ignore[no-untyped-call]
    placed = np.asarray(vertices, np.float64) * solved.grid.side + solved.grid.low
    return Mesh(placed, np.asarray(faces, np.int64))


def _solve(
    points: OrientedPoints, is_free: IsFree, support: Plane | None, grid: SolidGrid, coarse: _Solved | None
) -> _Solved:
    nodes = grid.nodes()
    free = np.zeros(len(nodes), bool) if coarse is None else coarse.is_surely_free(nodes)
    free[~free] = is_free(nodes[~free])
    measured = _thinned(points, grid)
    near = np.isfinite(cKDTree(measured.xyz).query(nodes, distance_upper_bound=_ON_POINTS * grid.side, workers=-1)[0])
    least = np.where(free, _OUTSIDE, -np.inf)
    if support is not None:
        below = -support.height(nodes) / grid.side
        least = np.maximum(least, np.where(below > 0, below, -np.inf))
    least[grid.border()] = np.maximum(least[grid.border()], _FAR_OUTSIDE)
    least[near] = -np.inf
    outside = (least > 0).reshape(grid.shape)
    deep = binary_erosion(outside, np.ones((3, 3, 3)), _FREE_DEEP, border_value=1).ravel()
    phi = np.ones(len(nodes)) if coarse is None else coarse.at(nodes) * (coarse.grid.side / grid.side)
    phi[deep] = np.maximum(least[deep], _OUTSIDE)
    inner = np.flatnonzero(~deep)
    matrix, right = _normal_equations(measured, grid, inner, phi, deep)
    diagonal = matrix.diagonal() + np.float32(_INERTIA)
    values, bound = phi[inner].astype(np.float32), least[inner].astype(np.float32)
    for _ in range(_ROUNDS):
        held = values < bound
        penalised = diagonal + np.float32(_PENALTY) * held
        matrix.setdiag(penalised)
        values, _ = cg(
            matrix,
            right + np.float32(_PENALTY) * np.where(held, bound, np.float32(0)),
            x0=values,
            rtol=_EXACT,
            maxiter=max(_STEPS, _WORK // max(len(inner), 1)),
            M=diags_array(1 / penalised),
        )
    phi[inner] = values
    return _Solved(grid, phi.reshape(grid.shape), free.reshape(grid.shape))


def _thinned(points: OrientedPoints, grid: SolidGrid) -> OrientedPoints:
    """Average the points in half a cell; where normals differ, or few points are, they weigh less."""
    half = np.floor((points.xyz - grid.low) / (grid.side / 2)).astype(np.int64)
    _, cell = np.unique(np.ravel_multi_index(tuple(half.T), [2 * count for count in grid.shape]), return_inverse=True)
    total = np.bincount(cell, points.weight)
    kept = total > 0

    def mean(values: Floats) -> Floats:
        summed = np.stack([np.bincount(cell, points.weight * column) for column in values.T], axis=1)
        return summed[kept] / total[kept, None]

    normal = mean(points.normal)
    length = np.linalg.norm(normal, axis=1)
    weight = length * np.minimum(total[kept] / _ENOUGH, 1)
    return OrientedPoints(mean(points.xyz), normal / np.maximum(length, 1e-9)[:, None], weight)


def _normal_equations(
    points: OrientedPoints, grid: SolidGrid, inner: Ints, phi: Floats, deep: Bools
) -> tuple[csr_array, Floats]:
    """The least squares' matrix and right side for the inner nodes (M,), float32; the deep ones keep their φ."""
    step = _OFFSET * grid.side * points.normal
    root = diags_array(np.sqrt(points.weight))
    rows = [root @ _interpolation(points.xyz + side * step, grid) * size for side, size in ((0, 2.0), (1, 1), (-1, 1))]
    zero = np.zeros(len(points.xyz))
    wanted = np.concatenate([zero, root @ (zero + _OFFSET), root @ (zero - _OFFSET)])
    bend = np.sqrt(_SMOOTH) * _laplacian(grid.shape)
    equations = vstack([*rows, bend]).tocsr()
    wanted = np.concatenate([wanted, np.zeros(bend.shape[0])]) - equations @ np.where(deep, phi, 0)
    solved = equations[:, inner]
    matrix = (solved.T @ solved).T  # it is symmetric, and by rows it is multiplied faster than by columns
    return matrix.astype(np.float32), (solved.T @ wanted).astype(np.float32)


def _interpolation(places: Floats, grid: SolidGrid) -> csr_array:
    """Matrix (N,X·Y·Z) that interpolates values of the nodes at places (N,3), trilinearly."""
    index = (places - grid.low) / grid.side
    low = np.clip(np.floor(index).astype(np.int64), 0, np.array(grid.shape) - 2)
    part = index - low
    corners = [np.array(corner) for corner in np.ndindex(2, 2, 2)]
    column = np.stack([np.ravel_multi_index(tuple((low + corner).T), grid.shape) for corner in corners], axis=1)
    weight = np.stack([np.where(corner, part, 1 - part).prod(axis=1) for corner in corners], axis=1)
    row = np.repeat(np.arange(len(places)), len(corners))
    shape = len(places), int(np.prod(grid.shape))
    return coo_array((weight.ravel(), (row, column.ravel())), shape=shape).tocsr()


def _laplacian(shape: tuple[int, int, int]) -> csr_array:
    """Matrix of the Laplacian on a grid, in cells; across the border nothing changes."""
    middle, diagonals, offsets = np.zeros(shape), [], []
    for axis, stride in enumerate((shape[1] * shape[2], shape[2], 1)):
        has_next = np.ones(shape)
        has_next.swapaxes(0, axis)[-1] = 0
        middle -= has_next + np.flip(has_next, axis)
        diagonals += [has_next.ravel()[:-stride]] * 2
        offsets += [stride, -stride]
    return diags_array([*diagonals, middle.ravel()], offsets=[*offsets, 0]).tocsr()
