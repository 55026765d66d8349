"""A surface laid over a known one by the similarity that brings it nearest: size and place are then not judged.

Where nothing tells how the two lie (photos have no frame), many turns are tried on few points, the best on more, and
the best of those is brought home by distances along the normals. Parts that only one of the two has do not pull.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from services.edge.arrays import Floats
from services.edge.mesh.metrics import sample
from services.edge.mesh.nouns import Mesh

_STEPS = 20
_NEAR = 0.03  # of the surface's size: points farther from it belong to something else
_SOME = 20_000  # points enough for seven numbers
_TURNS = 200  # tried besides those that bring the axes of inertia together: 30 degrees from one to the next
_FEW, _MORE = 300, 3_000  # points a turn is tried with, at first and of the best
_BEST = 12  # turns that are tried with more
_KEPT = 0.8  # share of the points that pull: the nearest ones
_SAMPLES = 100_000
_ON_THE_THING = 0.05  # of its size: what is farther from it are its surroundings, which a reference does not have
_COMPLETE = 0.01  # of its size


@dataclass(frozen=True, slots=True)
class Overlay:
    """How far a surface lies from a reference after the best similarity, in shares of the reference's longest side.

    median, p90   distance of the surface's samples to the plane of the nearest sample of the reference
    complete      share of the reference within 0.01 of the surface
    beside        share of the surface farther than 0.05 from the reference, which the distances leave out
    """

    median: float
    p90: float
    complete: float
    beside: float


def overlay(mesh: Mesh, reference: Mesh) -> Overlay:
    """Lay the mesh over the reference, whatever their sizes and frames are, and measure. Deterministic.

    A thing that looks the same from several sides may be laid over turned. Two meshes of different things give large
    figures, no error.
    """
    rng = np.random.default_rng(0)
    truth, made = sample(reference, _SAMPLES, rng), sample(mesh, _SAMPLES, rng)
    start = _coarsely_laid(made.xyz, truth.xyz, rng)
    laid = laid_over(made.xyz, truth.xyz, truth.normals, start)
    return measured(laid, truth.xyz, truth.normals)


def measured(xyz: Floats, surface: Floats, normals: Floats) -> Overlay:
    """Points (N,3) that were laid over samples (M,3) of a reference with normals (M,3)."""
    size = float(np.ptp(surface, axis=0).max())
    gap, nearest = cKDTree(surface).query(xyz)
    on = gap < _ON_THE_THING * size
    back, _ = cKDTree(xyz).query(surface[:: max(1, len(surface) // _SOME)])
    complete, beside = float((back < _COMPLETE * size).mean()), float(1 - on.mean())
    if not on.any():
        return Overlay(float("inf"), float("inf"), complete, beside)
    off = np.abs(np.einsum("ni,ni->n", xyz[on] - surface[nearest[on]], normals[nearest[on]])) / size
    return Overlay(float(np.median(off)), float(np.percentile(off, 90)), complete, beside)


def laid_over(xyz: Floats, surface: Floats, normals: Floats, start: Floats) -> Floats:
    """(N,3) moved by `start` (4,4) and then by the similarity of least distances along the normals.

    Point to plane (Y. Chen, G. Medioni, 1992) with the scale as a seventh number: matching points to points instead
    shrinks whatever lacks a part of the surface.
    """
    tree = cKDTree(surface)
    near = _NEAR * float(np.ptp(surface, axis=0).max())
    centre = surface.mean(axis=0)
    xyz = xyz @ start[:3, :3].T + start[:3, 3] - centre
    some = np.random.default_rng(0).permutation(len(xyz))[:_SOME]
    for _ in range(_STEPS):
        points = xyz[some]
        gap, nearest = tree.query(points + centre)
        on = gap < near
        if on.sum() < 7:
            break
        points, normal = points[on], normals[nearest[on]]
        off = np.einsum("ni,ni->n", points + centre - surface[nearest[on]], normal)
        weight = 1 / np.maximum(np.abs(off), np.median(np.abs(off)) + 1e-9 * near)  # Huber's: the far pull no harder
        rows = np.concatenate(
            [np.cross(points, normal), normal, np.einsum("ni,ni->n", points, normal)[:, None]], axis=1
        )
        turn = np.linalg.lstsq(rows * weight[:, None], -off * weight, rcond=None)[0]
        xyz = (1 + turn[6]) * xyz @ Rotation.from_rotvec(turn[:3]).as_matrix().T + turn[3:6]
    moved: Floats = xyz + centre
    return moved


def _coarsely_laid(xyz: Floats, surface: Floats, rng: np.random.Generator) -> Floats:
    """(4,4) similarity that brings most of the points near the surface, the best of many turns."""
    few, more = rng.permutation(xyz)[:_FEW], rng.permutation(xyz)[:_MORE]
    target = cKDTree(rng.permutation(surface)[: 4 * _MORE])
    tried = sorted((_closer(few, target, turn, 8) for turn in _turns(xyz, surface)), key=lambda each: each[0])
    best = [_closer(more, target, start, 25) for _, start in tried[:_BEST]]
    return min(best, key=lambda each: each[0])[1]


def _turns(xyz: Floats, surface: Floats) -> list[Floats]:
    """Similarities (4,4) that bring the middles and the sizes together, in many turns."""
    a, b = xyz.mean(axis=0), surface.mean(axis=0)
    scale = float(np.sqrt(np.square(surface - b).sum() / len(surface) / (np.square(xyz - a).sum() / len(xyz))))
    ours, theirs = np.linalg.svd(xyz - a, full_matrices=False)[2], np.linalg.svd(surface - b, full_matrices=False)[2]
    flips = [theirs.T @ np.diag(signs) @ ours for signs in product((1, -1), repeat=3)]
    turns = [turn for turn in flips if np.linalg.det(turn) > 0]
    turns += list(Rotation.random(_TURNS, rng=np.random.default_rng(0)).as_matrix())
    starts: list[Floats] = []
    for turn in turns:
        start = np.eye(4)
        start[:3, :3] = scale * turn
        start[:3, 3] = b - scale * turn @ a
        starts.append(start)
    return starts


def _closer(points: Floats, target: cKDTree, start: Floats, steps: int) -> tuple[float, Floats]:
    """Point-to-point steps from `start`; the mean distance of the nearest `_KEPT`, over the scale, and where they end.

    Over the scale: else the smallest copy would be nearest to everything.
    """
    for _ in range(steps):
        moved = points @ start[:3, :3].T + start[:3, 3]
        gap, nearest = target.query(moved)
        kept = np.argsort(gap)[: int(_KEPT * len(gap))]
        start = _similarity(points[kept], target.data[nearest[kept]])
    gap = np.sort(target.query(points @ start[:3, :3].T + start[:3, 3])[0])[: int(_KEPT * len(points))]
    return float(gap.mean() / np.cbrt(max(np.linalg.det(start[:3, :3]), 1e-30))), start


def _similarity(xyz: Floats, other: Floats) -> Floats:
    """(4,4) of least squares from points to their partners.

    Shinji Umeyama, "Least-squares estimation of transformation parameters between two point patterns", PAMI 1991.
    """
    a, b = xyz.mean(axis=0), other.mean(axis=0)
    left, spread, right = np.linalg.svd((other - b).T @ (xyz - a))
    sign = np.array([1, 1, np.sign(np.linalg.det(left @ right))])
    scale = (spread * sign).sum() / max(np.square(xyz - a).sum(), 1e-30)
    similarity = np.eye(4)
    similarity[:3, :3] = scale * (left * sign) @ right
    similarity[:3, 3] = b - similarity[:3, :3] @ a
    return similarity
