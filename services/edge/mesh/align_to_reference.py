"""Align a surface to a reference by the best similarity transform, and measure the distance that remains.

Size and place are thus not judged. How the two lie is unknown at first (photos have no frame): many rotations are tried
on few points, the best on more points, and the best of those is refined by distances along the normals. Parts that
only one of the two has do not count.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from capture2vr.edge.arrays import Floats
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.sampling import sample
from capture2vr.edge.procrustes import procrustes

_STEPS = 20  # of the refinement along the normals
_STILL = 1e-6  # radians, share of the size, and of `_NEAR`: a step so small is the last
_NEAR = 0.03  # of the surface's size: points farther from it belong to something else
_SOME = 20_000  # points: enough for seven unknowns
_TURNS = 200  # random rotations, besides those that align the axes of inertia: 30 degrees from one to the next
_FEW, _MORE = 300, 3_000  # points that a rotation is tried with, at first, and if it is among the best
_COARSE, _FINE = 1_000, 12_000  # points of the reference that these are compared with
_BEST = 12  # rotations that are tried with more points
_NEAREST = 0.8  # share of the points that count in a trial: the nearest ones
_SAMPLES = 100_000  # points of each surface
_ON_THE_THING = 0.05  # of its size: points farther from it are surroundings, which a reference does not have
_COMPLETE = 0.01  # of its size: how near the surface must be to a part of the reference to cover it


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
    """Align the mesh to the reference, whatever their sizes and frames are, and measure the distance. Deterministic.

    A symmetric thing may be aligned in any of its equal poses. Two meshes of different things give large figures, no
    error.
    """
    rng = np.random.default_rng(0)
    truth, made = sample(reference, _SAMPLES, rng), sample(mesh, _SAMPLES, rng)
    start = _initial_alignment(made.xyz, truth.xyz, rng)
    laid = align_to_surface(made.xyz, truth.xyz, truth.normals, start)
    return measure_overlay(laid, truth.xyz, truth.normals)


def measure_overlay(xyz: Floats, surface: Floats, normals: Floats) -> Overlay:
    """Measure points (N,3), already aligned to samples (M,3) of a reference with normals (M,3)."""
    size = float(np.ptp(surface, axis=0).max())
    gap, nearest = cKDTree(surface).query(xyz, distance_upper_bound=_ON_THE_THING * size)
    on = np.isfinite(gap)
    back, _ = cKDTree(xyz).query(surface[:: max(1, len(surface) // _SOME)], distance_upper_bound=_COMPLETE * size)
    complete, beside = float(np.isfinite(back).mean()), float(1 - on.mean())
    if not on.any():
        return Overlay(float("inf"), float("inf"), complete, beside)
    off = np.abs(np.einsum("ni,ni->n", xyz[on] - surface[nearest[on]], normals[nearest[on]])) / size
    return Overlay(float(np.median(off)), float(np.percentile(off, 90)), complete, beside)


def align_to_surface(xyz: Floats, surface: Floats, normals: Floats, start: Floats) -> Floats:
    """Align points (N,3) to a surface: move them by `start` (4,4), then by the similarity of least distances to planes.

    ICP, point to plane (Y. Chen, G. Medioni, 1992), with the scale as a seventh unknown: matching points to points
    instead shrinks whatever lacks a part of the surface.
    """
    tree = cKDTree(surface)
    near = _NEAR * float(np.ptp(surface, axis=0).max())
    centre = surface.mean(axis=0)
    xyz = xyz @ start[:3, :3].T + start[:3, 3] - centre
    some = np.random.default_rng(0).permutation(len(xyz))[:_SOME]
    for _ in range(_STEPS):
        points = xyz[some]
        gap, nearest = tree.query(points + centre, distance_upper_bound=near)
        on = np.isfinite(gap)
        if on.sum() < 7:
            break
        points, normal = points[on], normals[nearest[on]]
        off = np.einsum("ni,ni->n", points + centre - surface[nearest[on]], normal)
        weight = 1 / np.maximum(np.abs(off), np.median(np.abs(off)) + 1e-9 * near)  # Huber: limits a point's pull
        rows = np.concatenate(
            [np.cross(points, normal), normal, np.einsum("ni,ni->n", points, normal)[:, None]], axis=1
        )
        turn = np.linalg.lstsq(rows * weight[:, None], -off * weight, rcond=None)[0]
        xyz = (1 + turn[6]) * xyz @ Rotation.from_rotvec(turn[:3]).as_matrix().T + turn[3:6]
        if np.abs(turn[[0, 1, 2, 6]]).max() < _STILL and np.abs(turn[3:6]).max() < _STILL * near:
            break
    moved: Floats = xyz + centre
    return moved


def _initial_alignment(xyz: Floats, surface: Floats, rng: np.random.Generator) -> Floats:
    """Similarity (4,4) that brings most of the points near the surface: the best of many rotations."""
    few, more = rng.permutation(xyz)[:_FEW], rng.permutation(xyz)[:_MORE]
    target = rng.permutation(surface)
    coarse, fine = cKDTree(target[:_COARSE]), cKDTree(target[:_FINE])
    trials = [_refine_by_points(few, coarse, start, 8) for start in _starts(xyz, surface)]
    tried = sorted(trials, key=lambda each: each[0])
    best = [_refine_by_points(more, fine, start, 25) for _, start in tried[:_BEST]]
    return min(best, key=lambda each: each[0])[1]


def _starts(xyz: Floats, surface: Floats) -> list[Floats]:
    """Similarities (4,4) that bring the middles and the sizes together, with many rotations."""
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


def _refine_by_points(points: Floats, target: cKDTree, start: Floats, steps: int) -> tuple[float, Floats]:
    """Refine `start` by point-to-point steps -> mean distance of the `_NEAREST` share over the scale, similarity (4,4).

    Divided by the scale, because the smallest copy would else be nearest to everything.
    """
    for _ in range(steps):
        moved = points @ start[:3, :3].T + start[:3, 3]
        gap, nearest = target.query(moved)
        near = np.argsort(gap)[: int(_NEAREST * len(gap))]
        similarity = procrustes(points[near], target.data[nearest[near]], scale=True)
        if similarity is None or np.abs(similarity - start).max() < _STILL * np.abs(start).max():
            break
        start = similarity
    gap = np.sort(target.query(points @ start[:3, :3].T + start[:3, 3])[0])[: int(_NEAREST * len(points))]
    return float(gap.mean() / np.cbrt(max(np.linalg.det(start[:3, :3]), 1e-30))), start
