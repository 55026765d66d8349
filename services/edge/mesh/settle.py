"""Vertices onto the zero set, evenly spread.

A distance that reaches 0 says how far to go. A learned one may have a floor: then its value near the surface says
nothing, but the distances at two places across the surface, one on either side, still differ by twice the offset.
"""

from __future__ import annotations

import numpy as np

from services.edge.arrays import DistanceFn, Floats, Ints, Tick
from services.edge.mesh.band import evaluate, part_of

PULL_MOST = 0.75  # cells: a vertex never leaves the cells next to its own
RELAX = 0.5  # of the way to the neighbours' mean, inside the surface
LANDED = 0.05  # cells: a pulled and relaxed vertex is nearer than this; a lower floor does no harm
ASIDE = 0.5  # cells: where the two sides are asked
FACING = 0.3  # least cosine between what the two sides say and the normal: else they belong to other layers


def settle(
    distance: DistanceFn, read: DistanceFn, vertices: Floats, quads: Ints, side: float, floor: float, tick: Tick
) -> Floats:
    """(V,3) vertices of (E,4) quads moved onto the zero set; side is the cell's.

    `read` is a cheaper form of the field: good enough before the vertices are spread.
    """
    f, g = evaluate(read, vertices, part_of(tick, 0, 0.4))
    vertices = vertices - np.clip(f - floor, 0, PULL_MOST * side)[:, None] * g
    ends = np.concatenate([quads[:, [i, (i + 1) % 4]] for i in range(4)])
    vertices = vertices + RELAX * _inside_surface(_towards_neighbours(vertices, ends), g)
    f, g = evaluate(distance, vertices, part_of(tick, 0.4, 0.9))
    landed = vertices - np.minimum(f, PULL_MOST * side)[:, None] * g
    if floor < LANDED * side:
        return landed
    floating = np.flatnonzero(f > LANDED * side)
    pull = np.clip(f[floating] - floor, 0, PULL_MOST * side)
    landed[floating] = _between(distance, vertices[floating], g[floating], pull, side, part_of(tick, 0.9, 1))
    return landed


def _between(distance: DistanceFn, vertices: Floats, normals: Floats, pull: Floats, side: float, tick: Tick) -> Floats:
    """Vertices moved along their normals to where both sides are as far; where the sides disagree, by their pull."""
    aside = ASIDE * side * normals
    f, g = evaluate(distance, np.concatenate([vertices - aside, vertices + aside]), tick)
    (below, above), (g_below, g_above) = np.split(f, 2), np.split(g, 2)
    facing = np.minimum(-np.einsum("vx,vx->v", g_below, normals), np.einsum("vx,vx->v", g_above, normals)) > FACING
    offset = np.clip((below - above) / 2, -ASIDE * side, ASIDE * side)
    moved: Floats = vertices + np.where(facing, offset, -pull)[:, None] * normals
    return moved


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
