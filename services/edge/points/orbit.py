"""Whether somebody walked around one thing, or looked around in a room: told by the cameras alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from services.edge.arrays import Floats
from services.edge.capture.nouns import Frame

_MISSED_BY = 0.25
"""Median distance of the optical axes from the point they meet at, over that from the cameras to it: around a thing
that fills the picture 0.02 to 0.15; from the middle of a room outward the point lies behind half of the cameras."""
_IN_FRONT = 0.9
"""Share of the cameras that must have the point before them."""
_ROUNDS = 10


def around_one_thing(frames: Sequence[Frame]) -> bool:
    """Whether the optical axes meet, near enough, at one point before the cameras."""
    poses = np.stack([np.asarray(frame.camera_to_world, np.float64) for frame in frames])
    eyes, axes = poses[:, :3, 3], poses[:, :3, 2]
    point = meeting_point(eyes, axes)
    away = np.einsum("ni,ni->n", point - eyes, axes)
    missed = np.linalg.norm(point - eyes - away[:, None] * axes, axis=1)
    return bool((away > 0).mean() >= _IN_FRONT and np.median(missed) < _MISSED_BY * np.median(np.abs(away)))


def meeting_point(eyes: Floats, axes: Floats) -> Floats:
    """The point (3,) nearest to lines through eyes (N,3) along unit vectors axes (N,3), by the sum of the distances.

    Reweighted least squares: a few photos of something else do not move it. Parallel lines meet at their middle.
    """
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    weight = np.ones(len(eyes))
    point: Floats = eyes.mean(axis=0)
    for _ in range(_ROUNDS):
        normal = np.einsum("n,nij->ij", weight, across)
        right = np.einsum("n,nij,nj->i", weight, across, eyes)
        point = np.linalg.lstsq(normal, right, rcond=1e-9)[0]
        distance = np.linalg.norm(np.einsum("nij,nj->ni", across, point - eyes), axis=1)
        weight = 1 / np.maximum(distance, 1e-3 * np.median(distance) + 1e-12)
    return point
