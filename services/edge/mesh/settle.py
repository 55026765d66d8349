"""Move vertices onto the zero set of the field, and spread them evenly.

A distance that reaches 0 says how far to move. A learned field may stay above a floor: then its value near the surface
says nothing, but the values at two places, one on either side of the surface, still differ by twice the offset.
"""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import DistanceFn, Floats, Ints, Tick, part_of
from capture2vr.edge.mesh.band import evaluate

PULL_MOST = 0.75  # cells: a vertex never leaves the cells next to its own
RELAX = 0.5  # of the way to the neighbours' mean, inside the surface
ON_SURFACE = 0.05  # cells: a pulled and relaxed vertex is nearer than this; a lower floor does no harm
ASIDE = 0.5  # cells: distance from the vertex of the two places where the sides are compared
FACING = 0.3  # least cosine between the gradients on both sides and the normal: else they belong to other layers


def settle(
    distance: DistanceFn, read: DistanceFn, vertices: Floats, quads: Ints, side: float, floor: float, tick: Tick
) -> Floats:
    """Move the vertices (V,3) of quads (E,4) onto the zero set; side is the cell's.

    `read` is a cheaper, cached form of the field: good enough before the vertices are spread.
    """
    f, g = evaluate(read, vertices, part_of(tick, 0, 0.4))
    vertices = vertices - np.clip(f - floor, 0, PULL_MOST * side)[:, None] * g
    ends = np.concatenate([quads[:, [i, (i + 1) % 4]] for i in range(4)])
    vertices = vertices + RELAX * _inside_surface(_towards_neighbours(vertices, ends), g)
    f, g = evaluate(distance, vertices, part_of(tick, 0.4, 0.9))
    pulled = vertices - np.minimum(f, PULL_MOST * side)[:, None] * g
    if floor < ON_SURFACE * side:
        return pulled
    floating = np.flatnonzero(f > ON_SURFACE * side)
    pull = np.clip(f[floating] - floor, 0, PULL_MOST * side)
    pulled[floating] = _centre_between_sides(
        distance, vertices[floating], g[floating], pull, side, part_of(tick, 0.9, 1)
    )
    return pulled


def _centre_between_sides(
    distance: DistanceFn, vertices: Floats, normals: Floats, pull: Floats, side: float, tick: Tick
) -> Floats:
    """Move vertices along their normals to where both sides are equally far; where the sides disagree, by `pull`."""
    aside = ASIDE * side * normals
    f, g = evaluate(distance, np.concatenate([vertices - aside, vertices + aside]), tick)
    (below, above), (g_below, g_above) = np.split(f, 2), np.split(g, 2)
    facing = np.minimum(-np.einsum("vx,vx->v", g_below, normals), np.einsum("vx,vx->v", g_above, normals)) > FACING
    offset = np.clip((below - above) / 2, -ASIDE * side, ASIDE * side)
    moved: Floats = vertices + np.where(facing, offset, -pull)[:, None] * normals
    return moved


def _towards_neighbours(vertices: Floats, ends: Ints) -> Floats:
    """Vectors (V,3) from each vertex to the mean of its neighbours along the (L,2) sides of quads."""
    both = np.concatenate([ends, ends[:, ::-1]])
    count = np.maximum(np.bincount(both[:, 0], minlength=len(vertices)), 1)
    sums = [np.bincount(both[:, 0], vertices[both[:, 1], axis], len(vertices)) for axis in range(3)]
    away: Floats = np.stack(sums, axis=1) / count[:, None] - vertices
    return away


def _inside_surface(moves: Floats, normals: Floats) -> Floats:
    """Remove the part of moves (V,3) along the unit normals."""
    inside: Floats = moves - np.einsum("vx,vx->v", moves, normals)[:, None] * normals
    return inside
