"""Whether a place on the mesh is backed by points: the edge of what was measured, told by the points' own spacing.

Distance alone cannot tell: among 10,000 random points gaps of 1.7 spacings are common inside the surface, and the same
distance past the border is an overshoot. What tells them apart is that inside, points lie all round. So a place is
unbacked when a disc of two spacings' radius without any points can be laid over it in the surface: the complement of
the points' alpha shape. Such a disc holds 12.6 points on average, so inside it is empty once in 300,000 places.

v a vertex, n its normal, s the spacing around it, R = 2 s
m(v) = max over discs that cover v of (distance from the disc's centre to the nearest point − R)
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from services.edge.arrays import Bools, Floats, Ints, Tick

DISC = 2.0  # R in spacings
HOLE_DISC = 1.5  # the largest empty one among 10,000 random points has 2.2, so holes must be weighed by area as well
NEIGHBOURS = 40  # reaches 3.6 spacings: past the far rim of an empty disc there is nothing to see
DIRECTIONS = 16  # 22.5° apart: m is then off by 0.02 R at most
CENTRES = (0.5, 1.0)  # of R away from v: the rim for borders, the middle for small holes
CHUNK = 2_048  # vertices at once: 32 discs × 40 points × 4 B are 10 MB, near the cache
SOME = 16  # neighbours of the first, cheap look
LEAN = 0.15  # the mean of the neighbours leans 0.42 of their reach at a border; less than this is inside
LAYER = 0.5  # spacings off the tangent plane before a point is of another layer,
SLOPE = 1.0  # and this much more per distance along it: less would lose the points round a tight fold
FAR = 1e3  # spacings: where a point of another layer is put, out of every disc
SPACING_NEIGHBOURS = 24  # enough for the spacing to a tenth


def layer_spacing(near: Floats, normals: Floats, tree: cKDTree) -> Floats:
    """(N,) spacing of the points within their own layer. normals (N,3) of the surface at the points."""
    k = min(SPACING_NEIGHBOURS + 1, len(near))
    away, index = tree.query(near, k=k, workers=-1)
    reach = away[:, -1]
    own = _own_layer(near[index] - near[:, None], normals, reach * np.sqrt(np.pi / k))
    spacing: Floats = reach * np.sqrt(np.pi / np.maximum(own.sum(axis=1), 1))
    return np.maximum(spacing, 0.1 * float(np.median(spacing)))


def overhang(
    vertices: Floats, normals: Floats, near: Floats, spacing: Floats, tree: cKDTree, tick: Tick
) -> tuple[Floats, Floats]:
    """(V,) m(v) in spacings for borders and for holes, clipped to [−1, 2].

    Borders count the points of the vertex's own layer, so that cloth may end above other cloth. Holes count all points
    and take a smaller disc, which sees holes of odd shapes too: what they say is weighed by area (`clean`).
    """
    some, all_round = min(SOME, len(near)), min(NEIGHBOURS, len(near))
    away, index = tree.query(vertices, k=some, workers=-1)
    around = np.median(spacing[index[:, :8]], axis=1)
    lean = near[index].mean(axis=1) - vertices
    lean -= np.einsum("vx,vx->v", lean, normals)[:, None] * normals
    leaning = np.linalg.norm(lean, axis=1) > LEAN * away[:, -1]
    border, hole = np.full(len(vertices), -1.0), np.full(len(vertices), -1.0)
    at = np.flatnonzero(leaning | (away[:, 0] > around))
    parts = np.array_split(at, len(at) // CHUNK + 1)
    for done, part in enumerate(parts):
        tick(done / len(parts))
        relative = near[tree.query(vertices[part], k=all_round, workers=-1)[1]] - vertices[part, None]
        flat = _unrolled(relative, normals[part], around[part])
        hole[part] = _largest_empty(flat, HOLE_DISC)
        flat[~_own_layer(relative, normals[part], around[part])] = FAR
        border[part] = _largest_empty(flat, DISC)
    return border, hole


def _own_layer(relative: Floats, normals: Floats, spacing: Floats) -> Bools:
    """(V,K) points of the same layer: inside a flat double cone around the tangent plane."""
    off = np.abs(np.einsum("vkx,vx->vk", relative, normals))
    along = np.sqrt(np.maximum(np.square(relative).sum(axis=2) - np.square(off), 0))
    own: Bools = off < LAYER * spacing[:, None] + SLOPE * along
    return own


def _unrolled(relative: Floats, normals: Floats, spacing: Floats) -> Floats:
    """(V,K,3) points around vertices -> (V,K,2) in the tangent plane and in spacings, float32.

    A point behind a crease is as far as it is in space, not as its shadow on the tangent plane.
    """
    x, y = _plane_axes(normals)
    flat = np.stack([np.einsum("vkx,vx->vk", relative, x), np.einsum("vkx,vx->vk", relative, y)], axis=2)
    length = np.maximum(np.linalg.norm(flat, axis=2), 1e-12)
    flat *= (np.linalg.norm(relative, axis=2) / length / spacing[:, None])[..., None]
    return flat.astype(np.float32)


def _largest_empty(flat: Floats, disc: float) -> Floats:
    """m(v) for (V,K,2) points around vertices and discs of that radius."""
    turn = np.arange(DIRECTIONS) * (2 * np.pi / DIRECTIONS)
    rim = disc * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    centres = np.concatenate([share * rim for share in CENTRES]).astype(np.float32)
    squared = np.square(flat).sum(axis=2)[:, None] - 2 * centres @ flat.transpose(0, 2, 1)  # less |centre|²
    gap = np.sqrt(np.maximum(squared.min(axis=2) + np.square(centres).sum(axis=1), 0)) - disc
    clipped: Floats = np.clip(gap.max(axis=1), -1.0, 2.0)
    return clipped


def _plane_axes(normals: Floats) -> tuple[Floats, Floats]:
    """Two unit vectors (V,3) at right angles to each normal and to each other."""
    least: Ints = np.argmin(np.abs(normals), axis=1)
    x = np.cross(normals, np.eye(3)[least])
    x /= np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-12)
    return x, np.cross(normals, x)
