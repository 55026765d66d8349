"""Fit a tangent plane to every point of a cloud, and measure the local spacing.

x_j  neighbours of the point x_i;  h_i  local spacing;  d_j = |x_j − x_i|
o_j = n·(x_j − x_i): offset of a neighbour from the plane through the point

1. Hypotheses: each pair of the 6 nearest neighbours spans a plane with the point. The one with the largest
   Σ exp(−(0.63 d_j/h)²)·exp(−(o_j / 0.15h)²) wins, so a plane across two layers loses to the plane of either.
2. The normal is then the weighted PCA's, three times, with the weights exp(−(0.88 d_j/h)²)·exp(−(o_j / 0.6h)²).

A PCA as the start can be a wrong plane, which re-weighting cannot leave. Normals more than 30° wrong, PCA → hypotheses:
folded T-shirt 24 → 13 %, car with interior 21 → 17 %, two sheets 1.5 spacings apart 30 → 1 %.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Floats, Tick, no_tick
from capture2vr.edge.field.quadrics import TINY, weighted_pca
from capture2vr.edge.parallel import in_threads, slices

NEIGHBOURS = 16  # enough for a stable plane at random spacing, few enough to stay inside a fold
SPACING_RANK = 8  # the 8th neighbour: its distance varies by a fifth at random spacing, the first one's by half
PAIRS = np.array(list(combinations(range(1, 7), 2))).T  # of the 6 nearest: 15 planes, one of them in the right layer
ON_PLANE = 0.15  # in spacings: a neighbour as far off a plane as this is hardly on it
JUDGE, REFINE = 0.63, 0.88  # per spacing: how fast a neighbour's weight falls, for hypotheses and PCA
ROUNDS = 3  # of the weighted PCA
LAYER = 0.6  # in spacings: how far off a plane a neighbour may lie before it counts as another layer's
CHUNK = 2_048  # points at once: 17 neighbours × 15 hypotheses × 4 B keep the arrays at 2 MB, in the cache


@dataclass(frozen=True, slots=True)
class Planes:
    """xyz (N,3), normals (N,3) of length 1 and arbitrary sign, spacing (N,): all float32, unit frame."""

    xyz: Floats
    normals: Floats
    spacing: Floats


def fit_planes(xyz: Floats, tree: cKDTree, normals: Floats | None = None, tick: Tick = no_tick) -> Planes:
    """Fit planes to all points; with `normals`, measure only the spacing. `tree` is the KD-tree of `xyz`."""
    fitted = np.empty((len(xyz), 3), np.float32) if normals is None else _unit(normals)
    spacing = np.empty(len(xyz), np.float32)

    def fit(part: slice) -> None:
        distance, index = tree.query(xyz[part], k=min(NEIGHBOURS + 1, len(xyz)))
        spacing[part] = rank_spacing(distance)
        if normals is None:
            distance = distance.astype(xyz.dtype)
            fitted[part] = _normals(xyz[index] - xyz[part, None], distance, spacing[part])

    in_threads(fit, slices(len(xyz), CHUNK), tick)
    return Planes(np.asarray(xyz, np.float32), fitted, spacing)


def rank_spacing(distance: Floats) -> Floats:
    """Local spacing (N,) from neighbour distances (N,K), self first: that of a random sheet with these distances."""
    rank = min(SPACING_RANK, distance.shape[1] - 1)
    spacing: Floats = distance[:, rank] * np.sqrt(np.pi / rank) + np.sqrt(TINY)
    return spacing


def _normals(relative: Floats, distance: Floats, spacing: Floats) -> Floats:
    """Normals (N,3) of points from their neighbours, relative (N,K,3) and sorted by distance (N,K), self first."""
    in_spacings = distance / spacing[:, None]
    normals = _best_hypothesis(relative, np.exp(-np.square(JUDGE * in_spacings)), spacing)
    near = np.exp(-np.square(REFINE * in_spacings))
    for _ in range(ROUNDS):
        offset = np.einsum("nkx,nx->nk", relative, normals)
        same_layer = np.exp(-np.square(offset / (LAYER * spacing[:, None])))
        normals, _ = weighted_pca(relative, near * same_layer)
    return normals


def _best_hypothesis(relative: Floats, near: Floats, spacing: Floats) -> Floats:
    """Normals (N,3) of the best planes through a point and two of its nearest: those with most neighbours on them."""
    first, second = PAIRS[:, PAIRS[1] < relative.shape[1]]
    if len(first) == 0:
        return weighted_pca(relative, near)[0]
    normals = np.cross(relative[:, first], relative[:, second])
    normals /= np.linalg.norm(normals, axis=2, keepdims=True) + TINY
    # matmul, not einsum: 1.3 ms against 4.8 ms a chunk.
    offset = np.matmul(relative, normals.transpose(0, 2, 1)) / (ON_PLANE * spacing[:, None, None])
    score = np.matmul(near[:, None], np.exp(-np.square(offset)))[:, 0]
    best: Floats = normals[np.arange(len(normals)), score.argmax(axis=1)]
    return best


def _unit(vectors: Floats) -> Floats:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    unit: Floats = np.asarray(vectors / np.maximum(length, TINY), np.float32)
    return unit
