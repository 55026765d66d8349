"""Extract an open mesh from an unsigned distance field (method: "extraction for open surfaces").

f, g   distance and gradient; h the cell's side. No sign exists, so a crossing is where the gradients of an edge's ends
       oppose and f_a + f_b < 1.75 h.

1. walk along the surface and evaluate f, g at the corners of the cells it crosses   (band.py),
   on a coarse grid first: where f is smooth there, the fine corners are interpolated (cached_field.py)
2. find the crossed edges and let their neighbours outvote the wrong ones            (crossings.py)
3. join them into quads, a vertex per cell and layer                                 (dual.py)
4. pull the vertices onto the zero set, spread them evenly, pull them once more      (settle.py)
"""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import DistanceFn, Floats, Ints, Tick, no_tick, part_of
from capture2vr.edge.mesh.band import floor_of, walk
from capture2vr.edge.mesh.cached_field import smooth_cells, with_cache
from capture2vr.edge.mesh.crossings import find_crossings
from capture2vr.edge.mesh.dual import connect, triangles
from capture2vr.edge.mesh.grid import Grid, grid_around
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.settle import settle

COARSEST = 48  # cells along the longest side: in a coarser grid no cell is smooth
FLOOR_SHARE, COARSE_SHARE, WALK_SHARE = 0.01, 0.2, 0.6  # of the run time, measured with a network at 128³ and 256³


def extract(distance: DistanceFn, near: Floats, *, resolution: int, tick: Tick = no_tick) -> Mesh:
    """Mesh the zero set of a field in the unit frame.

    near (N,3) are points that the surface lies near; resolution is the number of cells along their longest side.
    `tick` is called with the fraction done before every slab of queries and may raise `Cancelled`.
    The mesh overshoots open borders by up to a cell and may have pin-holes: `clean` is the next step. It is empty where
    the field has no zero set near the points. Raises ValueError for points without extent.
    """
    near = np.asarray(near, np.float64)
    grid = grid_around(near, resolution)
    floor = floor_of(distance, near, part_of(tick, 0, FLOOR_SHARE))
    coarser = 0
    while np.ptp(near, axis=0).max() >= COARSEST * 2 ** (coarser + 1) * grid.side:
        coarser += 1
    return extract_on_grid(distance, near, grid, floor=floor, coarser=coarser, tick=part_of(tick, FLOOR_SHARE, 1))


def extract_on_grid(
    distance: DistanceFn, near: Floats, grid: Grid, *, floor: float = 0.0, coarser: int = 0, tick: Tick = no_tick
) -> Mesh:
    """Mesh the zero set of a field on a grid that is given, as `extract` does on one that it makes.

    floor    the field's value where it should be 0
    coarser  how many grids of 2, 4, … times the cell side are cached first

    With equal grids, floors and caches two parts of one scene have the same vertices where both see the same points.
    """
    read = _coarse_first(distance, near, grid, floor, coarser, part_of(tick, 0, COARSE_SHARE))
    band = walk(read, near, grid, floor, part_of(tick, COARSE_SHARE, WALK_SHARE))
    crossings = find_crossings(band, grid)
    del band
    quads, vertex = connect(crossings)
    vertices = _mean_by(vertex, np.repeat(crossings.xyz, 4, axis=0))
    vertices = settle(distance, read, vertices, quads, grid.side, floor, part_of(tick, WALK_SHARE, 1))
    tick(1.0)
    return Mesh(vertices, triangles(vertices, quads, crossings.normal))


def _coarse_first(distance: DistanceFn, near: Floats, grid: Grid, floor: float, coarser: int, tick: Tick) -> DistanceFn:
    """Return the field with a cache: interpolated on grids of 2, 4, … times the cell side, where they are smooth."""
    if coarser == 0:
        return distance
    coarse = Grid(grid.origin, 2 * grid.side)
    read = _coarse_first(distance, near, coarse, floor, coarser - 1, part_of(tick, 0, COARSE_SHARE))
    return with_cache(smooth_cells(walk(read, near, coarse, floor, part_of(tick, COARSE_SHARE, 1)), coarse), distance)


def _mean_by(group: Ints, values: Floats) -> Floats:
    """Mean of the (N,3) values of each group 0…G−1."""
    count = np.bincount(group)
    return np.stack([np.bincount(group, values[:, axis]) for axis in range(3)], axis=1) / count[:, None]
