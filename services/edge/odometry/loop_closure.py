"""Loop closure: align key frames that see the same surface at different times, which removes the drift."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from services.edge.arrays import Floats, Tick
from services.edge.odometry.icp import align
from services.edge.odometry.pose_graph import Edge
from services.edge.odometry.pyramid import Level, pyramid
from services.edge.odometry.relocalise import relocalise

_APART = 2
"""Least difference of the indices of two key frames of a loop: neighbours are aligned already."""
_PER_KEY = 2
"""Loops tried per key frame: with the oldest frame that overlaps it, where the drift is largest, and with the one that
overlaps it most."""
_SHARED = 0.4
"""Least share of a key frame's pixels that project onto the other one's surface, for an attempt."""
_DRIFT = 0.2
"""Relative depth by which a pixel may miss that surface, given how far the poses may have drifted."""
_PROBE = 400
"""Pixels sampled to estimate that share."""
_SPREAD_DEG = 60.0
"""Largest angle between the optical axes of two cameras: beyond it they share too little."""


def close_loops(keys: Sequence[Level], poses: Floats, tick: Tick) -> list[Edge]:
    """Align the key frames that overlap according to the tracked poses (K,4,4); return an edge for each success."""
    pairs = _overlapping_pairs(keys, poses)
    edges = []
    for number, (old, new) in enumerate(pairs):
        edge = _align_pair(keys, old, new, np.linalg.inv(poses[old]) @ poses[new])
        edges += [] if edge is None else [edge]
        tick((number + 1) / len(pairs))
    return edges


def _align_pair(keys: Sequence[Level], old: int, new: int, guess: Floats) -> Edge | None:
    """Align two key frames from a guess, or else from matched features; None where both fail."""
    source = pyramid(keys[new])
    fit = align(source, pyramid(keys[old]), guess)
    if fit is None or not fit.sound:
        fit = relocalise(source, keys[old])
    return None if fit is None else Edge(old, new, fit.pose, fit.information)


def _overlapping_pairs(keys: Sequence[Level], poses: Floats) -> list[tuple[int, int]]:
    """Return the pairs (old, new) of key frames that overlap enough to be aligned."""
    probes = [_sample_points(level) for level in keys]
    pairs = []
    for new in range(_APART, len(keys)):
        shares = np.array([_overlap(keys, probes, poses, old, new) for old in range(new - _APART + 1)])
        meets = np.flatnonzero(shares > _SHARED)
        if len(meets):
            pairs += [(int(old), new) for old in sorted({int(meets[0]), int(np.argmax(shares))})][:_PER_KEY]
    return pairs


def _sample_points(level: Level) -> Floats:
    """Sample up to _PROBE points (N,3) in the camera's frame, evenly over the image."""
    q = level.inverse_depth.ravel()
    known = np.flatnonzero(q)
    at = known[np.linspace(0, len(known) - 1, min(len(known), _PROBE)).astype(int)]
    points: Floats = level.rays[at] / q[at, None]
    return points


def _overlap(keys: Sequence[Level], probes: Sequence[Floats], poses: Floats, old: int, new: int) -> float:
    """Estimate the share of the new key frame's points that the old one sees, with tolerance for drift."""
    if poses[old][:3, 2] @ poses[new][:3, 2] < np.cos(np.radians(_SPREAD_DEG)):
        return 0.0
    between = np.linalg.inv(poses[old]) @ poses[new]
    x, y, z = between[:3, :3] @ probes[new].T + between[:3, 3:]
    z = np.maximum(z, 1e-6)
    camera, q = keys[old].camera, keys[old].inverse_depth
    u, v = np.rint(x / z * camera.fx + camera.cx), np.rint(y / z * camera.fy + camera.cy)
    inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    seen = q[v[inside].astype(int), u[inside].astype(int)]
    return float(np.count_nonzero(np.abs(seen * z[inside] - 1) < _DRIFT)) / max(len(z), 1)
