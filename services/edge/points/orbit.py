"""Decide from the camera poses alone whether somebody walked around one object or looked around in a room."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from services.edge.arrays import Floats
from services.edge.capture.nouns import Frame

_MISSED_BY = 0.25
"""Largest median distance of the optical axes from their meeting point, over the median distance of the cameras from
it. Around an object that fills the picture it is 0.02 to 0.15; for cameras that look outward from the middle of a room,
the point is behind half of them."""
_IN_FRONT = 0.9
"""Share of the cameras that must have the point in front of them."""
_ROUNDS = 10
"""Rounds of reweighted least squares."""


def orbits_one_object(frames: Sequence[Frame]) -> bool:
    """Return whether the optical axes of the posed frames meet, approximately, at one point in front of the cameras."""
    poses = np.stack([np.asarray(frame.camera_to_world, np.float64) for frame in frames])
    eyes, axes = poses[:, :3, 3], poses[:, :3, 2]
    point = meeting_point(eyes, axes)
    away = np.einsum("ni,ni->n", point - eyes, axes)
    missed = np.linalg.norm(point - eyes - away[:, None] * axes, axis=1)
    return bool((away > 0).mean() >= _IN_FRONT and np.median(missed) < _MISSED_BY * np.median(np.abs(away)))


def meeting_point(eyes: Floats, axes: Floats) -> Floats:
    """Return the point (3,) with the least sum of distances to the lines through eyes (N,3) along unit axes (N,3).

    By reweighted least squares, which is robust against a few photos of something else. For parallel lines it is in the
    middle between them.
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
