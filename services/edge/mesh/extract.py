"""An unsigned distance field to an open mesh (method: "extraction for open surfaces").

f, g   distance and gradient; h the cell's side. No sign exists, so a crossing is where the gradients of an edge's ends
       oppose and f_a + f_b < 1.75 h.

1. walk along the surface and evaluate f, g at the corners of the cells it crosses   (band.py)
2. find the crossed edges and let their neighbours outvote the wrong ones            (crossings.py)
3. join them into quads, a vertex per cell and layer                                 (dual.py)
4. pull the vertices onto the zero set, relax them inside the surface, pull again
"""

from __future__ import annotations

import numpy as np

from services.edge.arrays import DistanceFn, Floats, Ints, Tick, no_tick
from services.edge.mesh.band import evaluate, part_of, walk
from services.edge.mesh.crossings import find_crossings
from services.edge.mesh.dual import connect, triangles
from services.edge.mesh.grid import grid_around
from services.edge.mesh.nouns import Mesh

PULLS = 2  # the second lands the relaxed vertices; a third moves them by less than a thousandth of a cell
PULL_MOST = 0.75  # cells: a vertex never leaves the cells next to its own
RELAX = 0.5  # of the way to the neighbours' mean, inside the surface

WALK_SHARE = 0.7  # of the time, from the local field at 128³ and 256³


def extract(distance: DistanceFn, near: Floats, *, resolution: int, tick: Tick = no_tick) -> Mesh:
    """Mesh the zero set of a field in the unit frame.

    near (N,3) are points that the surface lies near; resolution is the number of cells along their longest side.
    `tick` is called with the fraction done before every slab of queries and may raise `Cancelled`.
    The mesh overshoots open borders by up to a cell and may have pin-holes: `clean` is the next step. It is empty where
    the field has no zero set near the points. Raises ValueError for points without extent.
    """
    near = np.asarray(near, np.float64)
    grid = grid_around(near, resolution)
    band = walk(distance, near, grid, part_of(tick, 0, WALK_SHARE))
    crossings = find_crossings(band, grid)
    del band
    tick(WALK_SHARE)
    quads, vertex = connect(crossings)
    vertices = _mean_by(vertex, np.repeat(crossings.xyz, 4, axis=0))
    vertices = _settle(distance, vertices, quads, grid.side, part_of(tick, WALK_SHARE, 1))
    tick(1.0)
    return Mesh(vertices, triangles(vertices, quads, crossings.normal))


def _settle(distance: DistanceFn, vertices: Floats, quads: Ints, side: float, tick: Tick) -> Floats:
    """Vertices on the zero set, evenly spread."""
    ends = np.concatenate([quads[:, [i, (i + 1) % 4]] for i in range(4)])
    for turn in range(PULLS):
        f, g = evaluate(distance, vertices, part_of(tick, turn / PULLS, (turn + 1) / PULLS))
        vertices = vertices - np.minimum(f, PULL_MOST * side)[:, None] * g
        if turn + 1 < PULLS:
            vertices = vertices + RELAX * _inside_surface(_towards_neighbours(vertices, ends), g)
    return vertices


def _towards_neighbours(vertices: Floats, ends: Ints) -> Floats:
    """(V,3) from each vertex to the mean of its neighbours along the (L,2) sides of quads."""
    both = np.concatenate([ends, ends[:, ::-1]])
    count = np.maximum(np.bincount(both[:, 0], minlength=len(vertices)), 1)
    sums = [np.bincount(both[:, 0], vertices[both[:, 1], axis], len(vertices)) for axis in range(3)]
    away: Floats = np.stack(sums, axis=1) / count[:, None] - vertices
    return away


def _inside_surface(moves: Floats, normals: Floats) -> Floats:
    """Moves (V,3) without their share along the unit normals."""
    inside: Floats = moves - np.einsum("vx,vx->v", moves, normals)[:, None] * normals
    return inside


def _mean_by(group: Ints, values: Floats) -> Floats:
    """Mean of the (N,3) values of each group 0…G−1."""
    count = np.bincount(group)
    return np.stack([np.bincount(group, values[:, axis]) for axis in range(3)], axis=1) / count[:, None]
