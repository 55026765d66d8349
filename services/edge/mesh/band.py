"""The field at the grid corners next to the surface, found by walking along it.

The walk starts in the cells that hold points and goes on through every cell face that the surface crosses, so gaps
between points need no guessed dilation, and no corner is evaluated that the surface does not need.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from services.edge.arrays import Bools, DistanceFn, Floats, Ints, Tick, no_tick
from services.edge.mesh.grid import CORNERS, STEP, Grid, find, once, without
from services.edge.mesh.spacing import point_spacing

SLAB = 1 << 16  # queries between two ticks: some 0.2 s of the local field on one core
NEAR_ZERO = (
    1.75  # crossing: the two distances of an edge may add up to this many edges (1 on a plane, √3 across a fold)
)
TOUCHING = 0.25  # edges: two ends this near the surface see only their noise, so where they point proves nothing
WALK_SPACINGS = 3.0  # the walk ends this many local spacings (and 2 cells) away from the points: no far sheets


@dataclass(frozen=True, slots=True)
class Band:
    """Evaluated corners: keys (M,) sorted, distance (M,) and gradient (M,3) float32."""

    keys: Ints
    distance: Floats
    gradient: Floats

    def neighbours(self, axis: int) -> Ints:
        """(M,) index of the next corner along the axis, M where it is not in the band."""
        return find(self.keys, self.keys + STEP[axis])


def crosses(
    distance_a: Floats, gradient_a: Floats, distance_b: Floats, gradient_b: Floats, axis: int, side: float
) -> Bools:
    """Whether the surface passes between the lower ends a and the upper ends b of edges along an axis.

    The gradients oppose and both ends are near. Half-way between two layers the gradients oppose too, but there they
    point at each other.
    """
    opposed = np.einsum("nx,nx->n", gradient_a, gradient_b) < 0
    apart = gradient_b[:, axis] > gradient_a[:, axis]
    total = distance_a + distance_b
    near: Bools = opposed & (total < NEAR_ZERO * side) & (apart | (total < TOUCHING * side))
    return near


def walk(distance: DistanceFn, near: Floats, grid: Grid, tick: Tick) -> Band:
    """Evaluate the field at all corners of cells that the surface crosses. `tick` runs from 0 to 1."""
    tree = cKDTree(near)
    reach = WALK_SPACINGS * point_spacing(near, tree) + 2 * grid.side
    seeds, first = np.unique(grid.cells_of(near), return_index=True)
    band = Band(np.empty(0, np.int64), np.empty(0, np.float32), np.empty((0, 3), np.float32))
    seen: Ints = np.empty(0, np.int64)
    frontier: Ints = seeds
    left = 1.0
    while len(frontier):
        # How many rounds will follow is unknown; each takes half of what is left of the bar.
        band = _grow(band, distance, grid, frontier, part_of(tick, 1 - left, 1 - left / 2))
        seen, left = once(np.concatenate([seen, frontier])), left / 2
        grown, active = _across(band, grid, frontier)
        if frontier is seeds:
            grown = np.concatenate([grown, _pulled_cells(distance, near[first[~active]], grid)])
        frontier = without(grown, seen)
        centres = grid.xyz_of(frontier) + grid.side / 2
        away, nearest = tree.query(centres, workers=-1)
        frontier = frontier[away < reach[nearest]]
    tick(1.0)
    return band


def evaluate(distance: DistanceFn, xyz: Floats, tick: Tick) -> tuple[Floats, Floats]:
    """The field in slabs: (N,) distance, (N,3) gradient of length 1 (0 where the field gives none), float32."""
    d, g = np.empty(len(xyz), np.float32), np.empty((len(xyz), 3), np.float32)
    for start in range(0, len(xyz), SLAB):
        tick(start / len(xyz))
        part = slice(start, start + SLAB)
        d[part], g[part] = distance(xyz[part])
    length = np.linalg.norm(g, axis=1, keepdims=True)
    return d, np.divide(g, length, out=np.zeros_like(g), where=length > 0)


def part_of(tick: Tick, start: float, end: float) -> Tick:
    """A tick whose 0…1 is start…end of another."""
    return lambda fraction: tick(start + fraction * (end - start))


def _grow(band: Band, distance: DistanceFn, grid: Grid, cells: Ints, tick: Tick) -> Band:
    """The band with all corners of the cells."""
    keys = without((cells[:, None] + CORNERS).ravel(), band.keys)
    d, g = evaluate(distance, grid.xyz_of(keys), tick)
    order = np.argsort(merged := np.concatenate([band.keys, keys]), kind="stable")
    return Band(
        merged[order],
        np.concatenate([band.distance, d])[order],
        np.concatenate([band.gradient, g])[order],
    )


def _across(band: Band, grid: Grid, cells: Ints) -> tuple[Ints, Bools]:
    """Cells behind the crossed faces of these cells, and which of these cells are crossed at all."""
    corners = find(band.keys, cells[:, None] + CORNERS)
    d, g = band.distance[corners], band.gradient[corners]
    crossed = np.zeros((len(cells), 3, 2), bool)
    for axis, weight in enumerate((4, 2, 1)):
        for a in (c for c in range(8) if not c & weight):
            cut = crosses(d[:, a], g[:, a], d[:, a | weight], g[:, a | weight], axis, grid.side)
            for other, bit in enumerate((4, 2, 1)):
                if other != axis:
                    crossed[:, other, int(bool(a & bit))] |= cut
    steps = np.stack([-STEP, STEP], axis=1)
    return (cells[:, None, None] + steps)[crossed], np.asarray(crossed.any(axis=(1, 2)))


def _pulled_cells(distance: DistanceFn, xyz: Floats, grid: Grid) -> Ints:
    """Where the surface is for points that lie off it by more than a cell: the cells of their pulled copies."""
    if len(xyz) == 0:
        return np.empty(0, np.int64)
    d, g = evaluate(distance, xyz, no_tick)
    return grid.cells_of(xyz - d[:, None] * g)
