"""Loop closure: align key frames that see the same surface at different times, which removes the drift."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Floats, Tick, part_of
from capture2vr.edge.odometry.features import features_of
from capture2vr.edge.odometry.icp import IcpFit, align
from capture2vr.edge.odometry.place_recognition import similar_pairs
from capture2vr.edge.odometry.pose_graph import Edge, optimise_poses
from capture2vr.edge.odometry.pyramid import PackedLevel, pyramid
from capture2vr.edge.odometry.relocalise import relocalise

_MEETING_M = 3.0
"""Largest distance of two cameras that are looked for by their pictures: farther away a thing looks too different."""
_ROUNDS = 3
"""Most rounds: once the drift is less, more key frames overlap by their poses."""
_EVERY = 3
"""Of so many key frames in a row, one is looked for by its picture: they show the same place."""
_LONG_AGO = 20
"""Least difference of the indices of two key frames that are looked for by their pictures: what the poses of fewer say
is near enough to the truth."""
_DRIFT_M, _DRIFT_SHARE = 0.5, 0.015
"""How far tracked poses may be off: that much, two slips along a pattern, and that share of the way between two key
frames, five times what the tracker drifts on rendered walks. A loop that asks for more is refused: two rooms with the
same furniture look the same from many sides, and align with an agreement of 0.99 and more."""
_AGREEMENT = 0.97
"""Least agreement of a loop's alignment; one period away on a wallpaper that repeats itself it is up to 0.96."""
_APART = 2
"""Least difference of the indices of two key frames of a loop: neighbours are aligned already."""
_PER_KEY = 2
"""Loops tried per key frame: with the oldest frame that overlaps it, where the drift is largest, and with the one that
overlaps it most."""
_SHARED = 0.4
"""Least share of a key frame's pixels that project onto the other one's surface, for an attempt."""
_DRIFT = 0.2
"""Relative depth by which a pixel may miss that surface, given how far the poses may have drifted."""
_REACH = 1.5
"""Largest distance between two cameras that may see the same surface, over the sum of their median depths."""
_PROBE = 400
"""Pixels sampled to estimate that share."""
_SPREAD_DEG = 60.0
"""Largest angle between the optical axes of two cameras: beyond it they share too little."""


@dataclass(frozen=True, slots=True)
class ClosedWay:
    """The key frames' poses (K,4,4) with loops closed, and the alignments that closed them."""

    poses: Floats
    loops: tuple[Edge, ...]


def close_loops(keys: Sequence[PackedLevel], poses: Floats, steps: Sequence[Edge], tick: Tick) -> ClosedWay:
    """Align key frames that overlap by their poses (K,4,4) or look alike, and fit the poses to that and to the steps.

    Those that look alike are found although the poses have drifted; what would ask for more drift than there can be is
    refused, and what is wrong is outvoted.
    """
    way = _way_m(poses)
    seen = _look_alike(keys, poses, way)
    loops: list[Edge] = []
    tried: set[tuple[int, int]] = set()
    for number in range(_ROUNDS):
        part = part_of(tick, number / _ROUNDS, (number + 1) / _ROUNDS)
        pairs = [pair for pair in dict.fromkeys(seen + _overlapping_pairs(keys, poses)) if pair not in tried]
        tried.update(pairs)
        found = _align_pairs(keys, pairs, poses, way, part)
        if not found:
            break
        loops += found
        poses = optimise_poses(poses, [*steps, *loops])
    tick(1.0)
    return ClosedWay(poses, tuple(loops))


def _way_m(poses: Floats) -> Floats:
    """How far (K,) the camera has gone to each key frame, in metres."""
    way: Floats = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1))])
    return way


def _allowed_drift(way: Floats) -> Floats:
    """Return the plausible drift between key frames, in metres, by the length (...) of the path between them."""
    return _DRIFT_M + _DRIFT_SHARE * way


def _look_alike(keys: Sequence[PackedLevel], poses: Floats, way: Floats) -> list[tuple[int, int]]:
    """Return pairs (old, new) of key frames that look alike, of long ago, and may have met in spite of the drift."""
    some = np.arange(0, len(keys), _EVERY)
    eyes = poses[some, :3, 3]
    olds = [
        np.flatnonzero(
            (some <= new - _LONG_AGO)
            & (np.linalg.norm(eyes - poses[new, :3, 3], axis=1) < _MEETING_M + _allowed_drift(way[new] - way[some]))
        )
        for new in some.tolist()
    ]
    features = [features_of(keys[number].unpacked()) for number in some.tolist()]
    return [(int(some[old]), int(some[new])) for old, new in similar_pairs(features, olds)]


def _align_pairs(
    keys: Sequence[PackedLevel], pairs: Sequence[tuple[int, int]], poses: Floats, way: Floats, tick: Tick
) -> list[Edge]:
    """Align pairs of key frames; return an edge for each that succeeds and asks for no more drift than there may be."""
    edges = []
    for number, (old, new) in enumerate(pairs):
        guess = np.linalg.inv(poses[old]) @ poses[new]
        fit = _align_pair(keys, old, new, guess, float(_allowed_drift(way[new] - way[old])))
        edges += [] if fit is None else [Edge(old, new, fit.pose, fit.information)]
        tick((number + 1) / len(pairs))
    return edges


def _align_pair(keys: Sequence[PackedLevel], old: int, new: int, guess: Floats, allowed_m: float) -> IcpFit | None:
    """Align two key frames from a guess, or else from matched features; None where neither gives what can be."""
    source, target = pyramid(keys[new].unpacked()), pyramid(keys[old].unpacked())
    fit = align(source, target, guess)
    if fit is None or not _is_loop(fit, guess, allowed_m):
        fit = relocalise(source, target[-1])
    return fit if fit is not None and _is_loop(fit, guess, allowed_m) else None


def _is_loop(fit: IcpFit, guess: Floats, allowed_m: float) -> bool:
    """Return whether an alignment closes a loop: it is reliable, and its correction is within the plausible drift."""
    off_m = float(np.linalg.norm(fit.pose[:3, 3] - guess[:3, 3]))
    return fit.sound and fit.agreement > _AGREEMENT and off_m < allowed_m


def _overlapping_pairs(keys: Sequence[PackedLevel], poses: Floats) -> list[tuple[int, int]]:
    """Return the pairs (old, new) of key frames that overlap enough to be aligned.

    Only key frames near each other that look the same way are compared: their number does not grow with the way.
    """
    probes = [_sample_points(level) for level in keys]
    eyes, axes = poses[:, :3, 3], poses[:, :3, 2]
    reach = np.array([float(np.median(points[:, 2])) if len(points) else 0.0 for points in probes])
    pairs = []
    for new in range(_APART, len(keys)):
        before = slice(0, new - _APART + 1)
        near = np.linalg.norm(eyes[before] - eyes[new], axis=1) < _REACH * (reach[before] + reach[new])
        olds = np.flatnonzero(near & (axes[before] @ axes[new] > np.cos(np.radians(_SPREAD_DEG))))
        shares = np.array(
            [_overlap(keys[old], probes[new], np.linalg.inv(poses[old]) @ poses[new]) for old in olds.tolist()]
        )
        meets = olds[shares > _SHARED] if len(olds) else olds
        if len(meets):
            pairs += [(int(old), new) for old in sorted({int(meets[0]), int(olds[np.argmax(shares)])})][:_PER_KEY]
    return pairs


def _sample_points(level: PackedLevel) -> Floats:
    """Sample up to _PROBE points (N,3) in the camera's frame, evenly over the image."""
    q = level.inverse_depth.ravel()
    known = np.flatnonzero(q)
    at = known[np.linspace(0, len(known) - 1, min(len(known), _PROBE)).astype(int)]
    camera, z = level.camera, 1 / q[at].astype(np.float64)
    x, y = (at % camera.width - camera.cx) / camera.fx, (at // camera.width - camera.cy) / camera.fy
    return np.stack([x * z, y * z, z], axis=1)


def _overlap(old: PackedLevel, points: Floats, between: Floats) -> float:
    """Estimate the share of a new key frame's points (N,3) that an old one sees, with tolerance for drift.

    between (4,4): the new one's pose in the old one
    """
    x, y, z = between[:3, :3] @ points.T + between[:3, 3:]
    z = np.maximum(z, 1e-6)
    camera, q = old.camera, old.inverse_depth
    u, v = np.rint(x / z * camera.fx + camera.cx), np.rint(y / z * camera.fy + camera.cy)
    inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    seen = q[v[inside].astype(int), u[inside].astype(int)].astype(np.float64)
    return float(np.count_nonzero(np.abs(seen * z[inside] - 1) < _DRIFT)) / max(len(z), 1)
