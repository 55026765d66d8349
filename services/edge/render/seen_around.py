"""Look at a mesh from all around: the most of it that shows its inside, how thin it is, how ragged its borders are."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from capture2vr.edge.arrays import Floats, Ints
from capture2vr.edge.mesh.edges import border_loops
from capture2vr.edge.mesh.normals import face_normals
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.sampling import sample
from capture2vr.edge.render.rays import RaycastingScene

_DIRECTIONS, _SIDE = 20, 96
"""Directions that are looked from, spread evenly, and the rays along each side of a picture: shares to .02 %."""
_PLACES, _ENDS = 5_000, 0.02
"""Places on a mesh that tell how thin it is, and the share of them at either end of an axis that does not count."""
_SMOOTH = 0.01
"""Standard deviation of the smoothing of a border, of the mesh's longest side: a hem stays, a fringe does not."""
_ROUNDS, _WIDEST = 12, 0.1
"""Rounds in which the smoothing is adapted to the border's own length, and its most, of that length."""
_LEAST_BORDER = 0.1
"""Length of a border, of the longest side, below which it is a hole, and has no fringe."""


def largest_hole(mesh: Mesh) -> float:
    """Return the largest share of a mesh's pixels that show its inside, from 20 directions around: 0 of a closed one.

    Which side is the inside is not known of an open surface: it is the side that is seen less.
    """
    scene, normals = RaycastingScene(mesh), face_normals(mesh.vertices, mesh.faces)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    middle, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    side = (np.arange(_SIDE) + 0.5) / _SIDE * 2 - 1
    across, up = (each.ravel()[:, None] * radius for each in np.meshgrid(side, side))
    back, all_shown = [], []
    for direction in _around(_DIRECTIONS):
        u, v = np.linalg.svd(direction[None])[2][1:]
        starts = middle + 2 * radius * direction + across * u + up * v
        hits = scene.cast(starts, np.broadcast_to(-direction, starts.shape).copy())
        shown = hits.face[hits.face >= 0]
        back.append(int((normals[shown] @ direction < 0).sum()))
        all_shown.append(len(shown))
    behind, total = np.array(back), np.maximum(np.array(all_shown), 1)
    if 2 * behind.sum() > sum(all_shown):
        behind = np.array(all_shown) - behind
    return float((behind / total).max())


def thinness(mesh: Mesh) -> float:
    """Return how thick a mesh is over its breadth, along its own axes: 0 of a picture, a half of half a ball or pipe.

    A few places at either end of an axis do not count.
    """
    places = sample(mesh, _PLACES, np.random.default_rng(0)).xyz
    places -= places.mean(axis=0)
    along = places @ np.linalg.svd(places, full_matrices=False)[2].T
    thick, breadth, _ = np.sort(np.ptp(np.quantile(along, [_ENDS, 1 - _ENDS], axis=0), axis=0))
    return float(thick / max(breadth, 1e-300))


def _around(count: int) -> Floats:
    """Unit vectors (N,3), spread evenly over all directions (sunflower spiral)."""
    rise = 1 - (2 * np.arange(count) + 1) / count
    turn = np.arange(count) * np.pi * (3 - np.sqrt(5))
    flat = np.sqrt(1 - rise**2)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), rise], axis=1)


def fringe(mesh: Mesh, border: Ints) -> float:
    """Return how many times as long a mesh's borders are as when they are smoothed: 1 of clean cuts and without any.

    border  the mesh's `border_edges`
    """
    longest = float(np.ptp(mesh.vertices, axis=0).max())
    ragged = smooth = 0.0
    for loop in border_loops(mesh.faces, border):
        places = mesh.vertices[loop]
        length = _length(places)
        if length < _LEAST_BORDER * longest:
            continue
        even = _resampled(places, length, max(4 * len(loop), int(4 * length / (_SMOOTH * longest))))
        sigma = along = len(even) * _SMOOTH * longest / length
        for _ in range(_ROUNDS):  # a ragged border is longer than the way along which it is smoothed
            smoothed = _length(gaussian_filter1d(even, along, axis=0, mode="wrap"))
            along = min(sigma * length / max(smoothed, 1e-300), _WIDEST * len(even))
        ragged += length
        smooth += smoothed
    return ragged / smooth if smooth else 1.0


def _length(loop: Floats) -> float:
    return float(np.linalg.norm(loop - np.roll(loop, -1, axis=0), axis=1).sum())


def _resampled(loop: Floats, length: float, count: int) -> Floats:
    """Places (count,3) at equal distances along a closed polyline (N,3)."""
    closed = np.concatenate([loop, loop[:1]])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    wanted = np.arange(count) * length / count
    return np.stack([np.interp(wanted, along, column) for column in closed.T], axis=1)
