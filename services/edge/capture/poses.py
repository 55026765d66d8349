"""Poses: quaternions and matrices of every app become camera-to-world in OpenCV axes.

ARKit and OpenGL cameras look along -Z with Y up; OpenCV cameras look along +Z with Y down. Both have X right, so one
becomes the other by turning the camera half round its X axis: T_opencv = T_opengl diag(1, -1, -1, 1).
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from services.edge.arrays import Floats
from services.edge.errors import CaptureError

Axes = Literal["opencv", "opengl"]

OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
ORTHONORMAL_TOLERANCE = 1e-2  # apps print five digits; a scaled or sheared rotation is off by far more
_EXACT = 1e-13  # rounding of float64; rotations from quaternions are as exact as a decomposition would make them
MAX_DISTANCE = 1e6  # metres; the bound that points have


def bad_pose(file: str, reason: str, hint: str = "record again: tracking was lost") -> CaptureError:
    return CaptureError("CAPTURE_BAD_POSE", reason, file=file, hints=(hint,))


def pose_from_quaternion(xyz: Floats, xyzw: Floats) -> Floats:
    """(4,4) camera-to-world from a position (3,) and a quaternion (4,) in the order x, y, z, w, normalised here.

    A quaternion that is none gives NaN, for `checked_pose` to name: one lost frame must not lose the recording.
    """
    norm = float(np.linalg.norm(xyzw))
    if not 0.5 < norm < 2.0:  # apps write unit quaternions; NaN fails here too
        return np.full((4, 4), np.nan)
    x, y, z, w = xyzw / norm
    pose = np.eye(4)
    pose[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    pose[:3, 3] = xyz
    return pose


def checked_pose(matrix: Floats, *, axes: Axes, file: str) -> Floats:
    """(4,4) float64 camera-to-world in OpenCV axes with an exactly orthonormal rotation, from (3,4) or (4,4).

    Raises CAPTURE_BAD_POSE when it is not finite, not orthonormal within 1e-2, mirrored, or beyond 1,000 km.
    """
    pose = np.eye(4)
    pose[: len(matrix)] = matrix
    if not np.isfinite(pose).all():
        raise bad_pose(file, "has a pose that is not finite, or whose quaternion has no length")
    if np.abs(pose[:3]).max() > MAX_DISTANCE or np.abs(pose[3] - [0, 0, 0, 1]).max() > ORTHONORMAL_TOLERANCE:
        raise bad_pose(file, "has a pose that is no camera-to-world matrix")
    pose[:3, :3] = _nearest_rotation(pose[:3, :3], file)
    pose[3] = [0, 0, 0, 1]
    return pose @ OPENGL_TO_OPENCV if axes == "opengl" else pose


def _nearest_rotation(rotation: Floats, file: str) -> Floats:
    off = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if off > 2 * ORTHONORMAL_TOLERANCE:  # an error e in the entries shows as 2e in the product
        raise bad_pose(file, f"has a pose whose rotation is not orthonormal (off by {off:.3g})")
    if np.linalg.det(rotation) < 0:
        raise bad_pose(file, "has a pose that mirrors", "export with right-handed axes: flip one axis of every pose")
    if off < _EXACT:
        return rotation
    u, _, vt = np.linalg.svd(rotation)
    nearest: Floats = u @ vt
    return nearest
