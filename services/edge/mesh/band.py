"""Evaluate the field at the grid corners next to the surface, which are found by walking along it (a flood fill).

The walk starts in the cells that hold points and goes on through every cell face that the surface crosses, so gaps
between points need no guessed dilation, and no corner is evaluated that the surface does not need.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bools, DistanceFn, Floats, Ints, Tick, no_tick, part_of
from capture2vr.edge.mesh.grid import CORNERS, STEP, Grid, find, sorted_unique, without
from capture2vr.edge.mesh.spacing import point_spacing

# Queries per slab, between two ticks. The first few measure how fast the field is, then a slab takes SLAB_SECONDS: the
# local field answers 300,000 a second on one core, a large network 8,000, a GPU millions.
SLAB, SLAB_MOST, SLAB_GROWTH = 1 << 9, 1 << 18, 8.0
SLAB_SECONDS = 0.25
# Edge lengths: limit of the sum of a crossed edge's distances (1 on a plane, √3 across a fold), less twice the floor.
NEAR_ZERO = 1.75
FLOOR_POINTS = 2_000  # whose median distance is the field's floor: a learned field may never reach 0
TOUCHING = 0.25  # edge lengths: where the sum is below this, directions are noise and need not point apart
WALK_SPACINGS = 3.0  # the walk ends this many local spacings (and 2 cells) away from the points: no far sheets


@dataclass(frozen=True, slots=True)
class Band:
    """Evaluated corners: keys (M,) sorted, distance (M,) and gradient (M,3) float32.

    floor is the field's value where it should be 0.
    """

    keys: Ints
    distance: Floats
    gradient: Floats
    floor: float

    def neighbours(self, axis: int) -> Ints:
        """(M,) index of the next corner along the axis, M where it is not in the band."""
        return find(self.keys, self.keys + STEP[axis])


def crosses(
    distance_a: Floats, gradient_a: Floats, distance_b: Floats, gradient_b: Floats, axis: int, side: float, floor: float
) -> Bools:
    """Whether the surface passes between the lower ends a and the upper ends b of edges along an axis.

    The gradients oppose and both ends are near. Half-way between two layers the gradients oppose too, but there they
    point at each other.
    """
    opposed = np.einsum("nx,nx->n", gradient_a, gradient_b) < 0
    apart = gradient_b[:, axis] > gradient_a[:, axis]
    total = distance_a + distance_b
    near: Bools = opposed & (total < NEAR_ZERO * side + 2 * floor) & (apart | (total < TOUCHING * side))
    return near


def walk(distance: DistanceFn, near: Floats, grid: Grid, floor: float, tick: Tick) -> Band:
    """Evaluate the field at all corners of cells that the surface crosses. `tick` runs from 0 to 1."""
    tree = cKDTree(near)
    away_most = WALK_SPACINGS * point_spacing(near, tree) + 2 * grid.side
    seeds, first = np.unique(grid.cells_of(near), return_index=True)
    band = Band(np.empty(0, np.int64), np.empty(0, np.float32), np.empty((0, 3), np.float32), floor)
    visited: Ints = np.empty(0, np.int64)
    frontier: Ints = seeds
    left = 1.0
    while len(frontier):
        # The number of rounds is unknown; each takes half of what is left of the progress bar.
        band = _grow(band, distance, grid, frontier, part_of(tick, 1 - left, 1 - left / 2))
        visited, left = sorted_unique(np.concatenate([visited, frontier])), left / 2
        found, active = _cells_across(band, grid, frontier)
        if frontier is seeds:
            found = np.concatenate([found, _pulled_cells(distance, near[first[~active]], grid)])
        frontier = without(found, visited)
        centres = grid.xyz_of(frontier) + grid.side / 2
        away, nearest = tree.query(centres, workers=-1)
        frontier = frontier[away < away_most[nearest]]
    tick(1.0)
    return band


def evaluate(distance: DistanceFn, xyz: Floats, tick: Tick) -> tuple[Floats, Floats]:
    """Evaluate the field in slabs: distance (N,), gradient (N,3) of length 1 (0 where the field has none), float32."""
    d, g = np.empty(len(xyz), np.float32), np.empty((len(xyz), 3), np.float32)
    start, slab = 0, SLAB
    while start < len(xyz):
        tick(start / len(xyz))
        part, began = slice(start, start + slab), time.perf_counter()
        d[part], g[part] = distance(xyz[part])
        start += slab
        faster = SLAB_SECONDS / max(time.perf_counter() - began, 1e-6)
        slab = int(np.clip(slab * min(faster, SLAB_GROWTH), SLAB // 4, SLAB_MOST))
    length = np.linalg.norm(g, axis=1, keepdims=True)
    return d, np.divide(g, length, out=np.zeros_like(g), where=length > 0)


def floor_of(distance: DistanceFn, near: Floats, tick: Tick = no_tick) -> float:
    """Estimate the field's value where it should be 0: its median at the points (N,3)."""
    some = near[:: max(1, len(near) // FLOOR_POINTS)]
    return float(np.median(evaluate(distance, some, tick)[0]))


def _grow(band: Band, distance: DistanceFn, grid: Grid, cells: Ints, tick: Tick) -> Band:
    """Add all corners of the cells to the band."""
    keys = without((cells[:, None] + CORNERS).ravel(), band.keys)
    d, g = evaluate(distance, grid.xyz_of(keys), tick)
    order = np.argsort(merged := np.concatenate([band.keys, keys]), kind="stable")
    return Band(
        merged[order],
        np.concatenate([band.distance, d])[order],
        np.concatenate([band.gradient, g])[order],
        band.floor,
    )


def _cells_across(band: Band, grid: Grid, cells: Ints) -> tuple[Ints, Bools]:
    """Find the cells behind the crossed faces of these cells, and which of these cells (C,) are crossed at all."""
    corners = find(band.keys, cells[:, None] + CORNERS)
    d, g = band.distance[corners], band.gradient[corners]
    crossed = np.zeros((len(cells), 3, 2), bool)
    for axis, weight in enumerate((4, 2, 1)):
        for a in (c for c in range(8) if not c & weight):
            cut = crosses(d[:, a], g[:, a], d[:, a | weight], g[:, a | weight], axis, grid.side, band.floor)
            for other, bit in enumerate((4, 2, 1)):
                if other != axis:
                    crossed[:, other, int(bool(a & bit))] |= cut
    steps = np.stack([-STEP, STEP], axis=1)
    return (cells[:, None, None] + steps)[crossed], np.asarray(crossed.any(axis=(1, 2)))


def _pulled_cells(distance: DistanceFn, xyz: Floats, grid: Grid) -> Ints:
    """Cells of the surface near points that lie off it by more than a cell: those of the points pulled onto it."""
    if len(xyz) == 0:
        return np.empty(0, np.int64)
    d, g = evaluate(distance, xyz, no_tick)
    return grid.cells_of(xyz - d[:, None] * g)
