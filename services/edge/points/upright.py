"""Which way is up, when the capture does not say: from how people hold cameras, and from the floor they stand on."""

from __future__ import annotations

import numpy as np

from services.edge.arrays import Floats
from services.edge.points.plane import largest_plane

_FLOOR_TILT_DEG = 30.0
"""A plane tilted less than this against the cameras' own up is a floor or a table."""
_KNOWN_TILT_DEG = 5.0
"""The same against an up that the capture gives: sensors are within 1 degree, means over cameras within a few."""
_FLOOR_SHARE = 0.12
_FLOOR_REACH = 0.01
"""Thickness searched for a plane, as a share of the points' extent."""
_PANNED_DEG = 20.0
"""The cameras must have turned this much for their horizontal axes to span the horizon."""


def estimate_up(poses: Floats, xyz: Floats) -> Floats:
    """(3,) unit vector against gravity, capture frame, from poses (M,4,4) camera-to-world (OpenCV) and points (N,3).

    People level the horizon, so the cameras' x axes lie in the ground plane; where the cameras hardly turned, their
    mean up must do. A large plane near that direction then decides.
    """
    return level_up(_from_cameras(poses), xyz, within_deg=_FLOOR_TILT_DEG)


def level_up(up: Floats, xyz: Floats, *, within_deg: float = _KNOWN_TILT_DEG) -> Floats:
    """(3,) the normal of the floor or table among the points (N,3) if it is within `within_deg` of `up`, else `up`."""
    low, high = np.percentile(xyz, [2, 98], axis=0)
    floor = largest_plane(xyz - low, _FLOOR_REACH * float((high - low).max()), along=up, within_deg=within_deg)
    return floor.normal if floor is not None and floor.share > _FLOOR_SHARE else up


def _from_cameras(poses: Floats) -> Floats:
    right, image_up = poses[:, :3, 0], -poses[:, :3, 1]
    mean_up = image_up.sum(axis=0)
    values, vectors = np.linalg.eigh(right.T @ right / len(right))
    # The middle eigenvalue is the mean square of the sine of the turn about the vertical.
    if values[1] > np.sin(np.radians(_PANNED_DEG)) ** 2 / 4:
        vertical = vectors[:, 0]
        mean_up = vertical * np.sign(vertical @ mean_up or 1.0)
    length = float(np.linalg.norm(mean_up))
    return mean_up / length if length > 0 else np.array([0.0, 1.0, 0.0])
