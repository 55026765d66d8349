"""Estimate the up direction of a capture from its camera poses and from the floor or table in it."""

from __future__ import annotations

import numpy as np

from services.edge.arrays import Floats
from services.edge.points.plane import largest_plane

_FLOOR_TILT_DEG = 30.0
"""A plane tilted less than this against the up direction estimated from the cameras is a floor or a table."""
_KNOWN_TILT_DEG = 5.0
"""The same for an up direction given by the capture: sensors are within 1 degree, means over cameras within a few."""
_FLOOR_SHARE = 0.12
"""Least share of the points on a floor or table."""
_FLOOR_REACH = 0.01
"""Distance from a plane within which points belong to it, as a share of the points' extent."""
_PANNED_DEG = 20.0
"""Least rotation of the cameras about the vertical, for their horizontal axes to define the horizon."""


def estimate_up(poses: Floats, xyz: Floats) -> Floats:
    """Estimate the unit vector (3,) against gravity, from poses (M,4,4) camera-to-world (OpenCV) and points (N,3).

    People hold cameras level, so the cameras' x axes lie in the ground plane; if the cameras hardly turned, their mean
    up is taken instead. The normal of a large plane near this direction is preferred to it.
    """
    return level_up(_from_cameras(poses), xyz, within_deg=_FLOOR_TILT_DEG)


def level_up(up: Floats, xyz: Floats, *, within_deg: float = _KNOWN_TILT_DEG) -> Floats:
    """Return the normal (3,) of a floor or table in the points (N,3) within `within_deg` of `up`; without one `up`."""
    low, high = np.percentile(xyz, [2, 98], axis=0)
    floor = largest_plane(xyz - low, _FLOOR_REACH * float((high - low).max()), along=up, within_deg=within_deg)
    return floor.normal if floor is not None and floor.share > _FLOOR_SHARE else up


def _from_cameras(poses: Floats) -> Floats:
    """Estimate the up direction (3,) from camera poses (M,4,4) alone."""
    right, image_up = poses[:, :3, 0], -poses[:, :3, 1]
    mean_up = image_up.sum(axis=0)
    values, vectors = np.linalg.eigh(right.T @ right / len(right))
    # The middle eigenvalue is the mean squared sine of the rotation about the vertical.
    if values[1] > np.sin(np.radians(_PANNED_DEG)) ** 2 / 4:
        vertical = vectors[:, 0]
        mean_up = vertical * np.sign(vertical @ mean_up or 1.0)
    length = float(np.linalg.norm(mean_up))
    return mean_up / length if length > 0 else np.array([0.0, 1.0, 0.0])
