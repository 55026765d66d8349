"""Key frames that are no neighbours and look at one surface, aligned with each other: this takes the drift out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from services.edge.arrays import Floats, Tick
from services.edge.points.icp import align
from services.edge.points.levels import Level, pyramid
from services.edge.points.posegraph import Edge
from services.edge.points.recognise import recognise

_APART = 2
"""Key frames at least this many steps apart: neighbours are aligned already."""
_PER_KEY = 2
"""Loops tried for each key frame: the oldest frame that it meets, where drift shows most, and the one it shares most
with."""
_SHARED = 0.4
"""Share of a key frame's pixels that should fall on the other one's surface for a try."""
_DRIFT = 0.2
"""Relative depth by which a pixel may miss that surface, given how far poses may have drifted."""
_PROBE = 400
"""Pixels enough to tell that share."""
_SPREAD_DEG = 60.0
"""Cameras that look further apart than this share too little."""


def close_loops(keys: Sequence[Level], poses: Floats, tick: Tick) -> list[Edge]:
    """Edges between the key frames that poses (K,4,4), as tracked, say meet again."""
    pairs = _meetings(keys, poses)
    edges = []
    for number, (old, new) in enumerate(pairs):
        edge = _close(keys, old, new, np.linalg.inv(poses[old]) @ poses[new])
        edges += [] if edge is None else [edge]
        tick((number + 1) / len(pairs))
    return edges


def _close(keys: Sequence[Level], old: int, new: int, guess: Floats) -> Edge | None:
    source = pyramid(keys[new])
    fit = align(source, pyramid(keys[old]), guess)
    if fit is None or not fit.sound:
        fit = recognise(source, keys[old])
    return None if fit is None else Edge(old, new, fit.pose, fit.information)


def _meetings(keys: Sequence[Level], poses: Floats) -> list[tuple[int, int]]:
    """Pairs (old, new) to try."""
    probes = [_probe(level) for level in keys]
    pairs = []
    for new in range(_APART, len(keys)):
        shares = np.array([_shared(keys, probes, poses, old, new) for old in range(new - _APART + 1)])
        meets = np.flatnonzero(shares > _SHARED)
        if len(meets):
            pairs += [(int(old), new) for old in sorted({int(meets[0]), int(np.argmax(shares))})][:_PER_KEY]
    return pairs


def _probe(level: Level) -> Floats:
    """(_PROBE,3) points in the camera's frame, evenly over the image."""
    q = level.inverse_depth.ravel()
    known = np.flatnonzero(q)
    at = known[np.linspace(0, len(known) - 1, min(len(known), _PROBE)).astype(int)]
    points: Floats = level.rays[at] / q[at, None]
    return points


def _shared(keys: Sequence[Level], probes: Sequence[Floats], poses: Floats, old: int, new: int) -> float:
    """Share of the new key frame's points that the old one sees, as far as drifting poses can say."""
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
