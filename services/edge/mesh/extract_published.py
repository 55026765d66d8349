"""Extract a mesh as the published code of CAP-UDF and LevelSetUDF does, to compare whole methods.

Every cell of a grid is signed by itself, by the directions of the gradients at its corners relative to that of its
first corner, and meshed by itself, by marching cubes. So its triangles share no vertices with those of other cells.
`extract` is the product's own way.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from capture2vr.edge.arrays import DistanceFn, Floats, Ints, Tick, no_tick, part_of
from capture2vr.edge.mesh.nouns import Mesh

_PADDING = 0.05
"""Of the box beyond the points on every side, unit frame."""
_FARTHEST = 0.005
"""Unit frame: a cell with no corner nearer than this is skipped, or than half its diagonal where that is more."""
_FIELD_SHARE = 0.5
"""Of the run time, with a network at 128 cells."""
_CELLS_A_TICK = 1_000


def extract_published(distance: DistanceFn, near: Floats, *, resolution: int, tick: Tick = no_tick) -> Mesh:
    """Mesh the zero set of a field in the unit frame, cell by cell; the triangles are not joined.

    near (N,3) are points that the surface lies near; resolution is the number of cells along their longest side.
    `tick` is called with the fraction done and may raise `Cancelled`. The mesh is empty where no cell is crossed.
    """
    low, high = near.min(axis=0) - _PADDING, near.max(axis=0) + _PADDING
    side = float((high - low).max()) / resolution
    counts = np.ceil((high - low) / side).astype(np.int64) + 1
    cells, signed = _crossed_cells(distance, low, side, counts, part_of(tick, 0, _FIELD_SHARE))
    vertices, faces = _march(signed, part_of(tick, _FIELD_SHARE, 1))
    owner = np.repeat(np.arange(len(cells)), [len(each) for each in vertices])
    if not len(owner):
        return Mesh(np.empty((0, 3)), np.empty((0, 3), np.int64))
    starts = np.cumsum([0, *(len(each) for each in vertices)])
    xyz = low + side * (cells[owner] + np.concatenate(vertices))
    return Mesh(xyz, np.concatenate([each + start for each, start in zip(faces, starts, strict=False)]))


def _crossed_cells(distance: DistanceFn, low: Floats, side: float, counts: Ints, tick: Tick) -> tuple[Ints, Floats]:
    """Evaluate the field at all corners, layer by layer -> the cells (C,3) with two signs, and their signed distances
    (C,2,2,2)."""
    y, z = (low[axis] + side * np.arange(counts[axis]) for axis in (1, 2))
    layer = np.stack(np.meshgrid(0.0, y, z, indexing="ij"), axis=-1)[0].reshape(-1, 3)
    nearest = max(_FARTHEST, float(np.sqrt(3)) / 2 * side)
    cells, signed = [np.empty((0, 3), np.int64)], [np.empty((0, 2, 2, 2))]
    before: tuple[Floats, Floats] | None = None
    for number in range(counts[0]):
        layer[:, 0] = low[0] + side * number
        f, g = distance(layer)
        here = f.reshape(counts[1], counts[2]), g.reshape(counts[1], counts[2], 3)
        if before is not None:
            f8, g8 = (_corners(np.stack(pair)) for pair in zip(before, here, strict=True))
            same = np.einsum("yzx,yzabcx->yzabc", g8[:, :, 0, 0, 0], g8) >= 0
            values = np.where(same, f8, -f8)
            crossed = (f8.min(axis=(2, 3, 4)) <= nearest) & (values.min(axis=(2, 3, 4)) < 0)
            row, column = np.nonzero(crossed)
            cells.append(np.stack([np.full(len(row), number - 1), row, column], axis=1))
            signed.append(values[crossed])
        before = here
        tick((number + 1) / counts[0])
    return np.concatenate(cells), np.concatenate(signed)


def _corners(layers: Floats) -> Floats:
    """Values (2,Y,Z,…) of two layers of corners -> (Y−1,Z−1,2,2,2,…), those of each cell's eight corners."""
    windows = np.lib.stride_tricks.sliding_window_view(layers, (2, 2, 2), axis=(0, 1, 2))[0]
    return windows if layers.ndim == 3 else np.moveaxis(windows, 2, -1)


def _march(signed: Floats, tick: Tick) -> tuple[list[Floats], list[Ints]]:
    """Mesh every cell of signed distances (C,2,2,2), in units of its side -> vertices (K,3) and faces (T,3) of each."""
    from skimage.measure import marching_cubes

    march: Any = marching_cubes  # the library has no types
    vertices: list[Floats] = []
    faces: list[Ints] = []
    for number, values in enumerate(signed):
        try:
            corners, triangles, _, _ = march(values, 0.0)
        except RuntimeError:  # the zero set only touches a corner
            corners, triangles = np.empty((0, 3)), np.empty((0, 3), np.int64)
        vertices.append(np.asarray(corners, np.float64))
        faces.append(np.asarray(triangles, np.int64))
        if number % _CELLS_A_TICK == 0:
            tick(number / len(signed))
    return vertices, faces
