"""Cache the field on a coarse grid: where it is smooth it is interpolated, elsewhere it is evaluated.

i runs over the eight corners of a cell of the coarse grid, at x_i, with distance f_i and unit gradient g_i.

    σ_i = sign(g_i·g_0)                               one side of the surface within the cell; no global sign is needed
    a   = how fast f grows along g                    1 in a true distance, 0.8–1.2 in a learned one
    s(x) = Σ w_i σ_i (f_i + ½ a g_i·(x − x_i))        w_i trilinear, Σ w_i = 1: exact where the field is quadratic
    f = |s|,  g = sign(s) Σ w_i σ_i g_i

A cell is smooth where all g_i are nearly parallel and neighbouring corners predict each other's distance. Folds,
borders, a second layer and noise break that, and there the field itself is evaluated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Bools, DistanceFn, Floats, Ints
from capture2vr.edge.mesh.band import Band
from capture2vr.edge.mesh.grid import CORNERS, Grid, find

PARALLEL = 0.8  # least cosine between gradients of a smooth cell: its surface turns by less than 37°
MOST_ERROR = 0.02  # coarse cells: largest error of a predicted distance; 0.04 cost the car .003 of its F(.005)

# (8,3) corners of a cell in units of its side, in the order of CORNERS, and the (12,2) pairs that edges join.
PLACES = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)], np.float32)
PAIRS = np.array([(a, a | bit) for bit in (4, 2, 1) for a in range(8) if not a & bit])
# Least a of a smooth cell. Half-way between two flat sheets along the grid distances are predictable, but fall along g.
LEAST_SLOPE = 0.3
CHUNK = 1 << 15  # queries at once: 24 floats each, so the arrays in use stay in the cache


@dataclass(frozen=True, slots=True)
class SmoothCells:
    """Smooth cells: keys (C,) sorted, signed distance (C,8) and its gradient (C,8,3) at their corners."""

    grid: Grid
    keys: Ints
    signed: Floats
    gradient: Floats

    def interpolate(self, xyz: Floats, cells: Ints) -> tuple[Floats, Floats]:
        """Interpolate distance (N,) and gradient (N,3) at places xyz (N,3), each in one of these cells (N,)."""
        x = ((xyz - self.grid.xyz_of(self.keys[cells])) / self.grid.side).astype(np.float32)
        beside = x[:, None] - PLACES
        weight = np.prod(1 - np.abs(beside), axis=2)
        gradient = self.gradient[cells]
        predicted = self.signed[cells] + np.float32(self.grid.side / 2) * np.einsum("nix,nix->ni", gradient, beside)
        signed = np.einsum("ni,ni->n", weight, predicted)
        across = np.einsum("ni,nix->nx", weight, gradient)
        return np.abs(signed), np.where(signed[:, None] < 0, -across, across)


def smooth_cells(band: Band, grid: Grid) -> SmoothCells:
    """Find the smooth cells among those whose corners are all in the band."""
    corners = find(band.keys, band.keys[:, None] + CORNERS)
    complete = (corners < len(band.keys)).all(axis=1)
    keys, corners = band.keys[complete], corners[complete]
    gradient, distance = band.gradient[corners], band.distance[corners]
    cos = np.einsum("cix,cx->ci", gradient, gradient[:, 0])
    side = np.where(cos < 0, np.float32(-1), np.float32(1))
    signed = side * distance
    slope, error = _predict(signed, gradient := side[:, :, None] * gradient, grid.side)
    smooth = (np.abs(cos) > PARALLEL).all(axis=1) & (error < MOST_ERROR * grid.side) & (slope > LEAST_SLOPE)
    return SmoothCells(grid, keys[smooth], signed[smooth], slope[smooth, None, None] * gradient[smooth])


def with_cache(smooth: SmoothCells, distance: DistanceFn) -> DistanceFn:
    """Return the field that is interpolated in the smooth cells, and evaluated outside them."""

    def either(xyz: Floats) -> tuple[Floats, Floats]:
        cells = find(smooth.keys, smooth.grid.cells_of(xyz))
        known: Bools = cells < len(smooth.keys)
        f, g = np.empty(len(xyz), np.float32), np.empty((len(xyz), 3), np.float32)
        if not known.all():
            f[~known], g[~known] = distance(xyz[~known])
        rows = np.flatnonzero(known)
        for start in range(0, len(rows), CHUNK):
            part = rows[start : start + CHUNK]
            f[part], g[part] = smooth.interpolate(xyz[part], cells[part])
        return f, g

    return either


def _predict(signed: Floats, gradient: Floats, side: float) -> tuple[Floats, Floats]:
    """Slope a (C,) of each cell, and the largest error (C,) of predicting a corner's distance from the next one's."""
    a, b = PAIRS.T
    along = np.float32(side / 2) * (PLACES[b] - PLACES[a])
    step = np.einsum("cpx,px->cp", gradient[:, a] + gradient[:, b], along)
    rise = signed[:, b] - signed[:, a]
    slope = np.einsum("cp,cp->c", rise, step) / np.maximum(np.einsum("cp,cp->c", step, step), np.float32(1e-20))
    return slope, np.abs(rise - slope[:, None] * step).max(axis=1)
