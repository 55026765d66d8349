"""Convert the camera poses of every app, quaternions or matrices, to camera-to-world matrices in OpenCV axes.

ARKit and OpenGL cameras look along -Z with Y up; OpenCV cameras look along +Z with Y down. Both have X right, so one
becomes the other by a half turn of the camera about its X axis: T_opencv = T_opengl diag(1, -1, -1, 1).
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.errors import CaptureError
from capture2vr.sentences.sentence import say

Axes = Literal["opencv", "opengl"]

OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
ORTHONORMAL_TOLERANCE = 1e-2  # of an entry; apps print five digits, a scaled or sheared rotation is off by far more
_EXACT = 1e-13  # float64 rounding: a rotation this close, as from a quaternion, would not get better by an SVD
MAX_DISTANCE = 1e6  # metres from the origin; the same limit as for points


def bad_pose(file: str, reason: str, hint: str = say("record_again_tracking_lost")) -> CaptureError:
    """Return a CAPTURE_BAD_POSE error."""
    return CaptureError("CAPTURE_BAD_POSE", reason, file=file, hints=(hint,))


def pose_from_quaternion(xyz: Floats, xyzw: Floats) -> Floats:
    """Make a (4,4) pose from a position (3,) and a quaternion (4,) in the order x, y, z, w, which is normalised.

    An invalid quaternion gives a matrix of NaN, which `checked_pose` refuses later: one bad frame must not make the
    whole recording fail here.
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
    """Validate a camera-to-world matrix (3,4) or (4,4), and convert it to (4,4) float64 in OpenCV axes.

    The rotation is made exactly orthonormal. Raises CAPTURE_BAD_POSE when the matrix is not finite, not orthonormal
    within 1e-2, mirrored, or beyond 1,000 km.
    """
    pose = np.eye(4)
    pose[: len(matrix)] = matrix
    if not np.isfinite(pose).all():
        raise bad_pose(file, say("has_camera_pose_not_finite"))
    if np.abs(pose[:3]).max() > MAX_DISTANCE or np.abs(pose[3] - [0, 0, 0, 1]).max() > ORTHONORMAL_TOLERANCE:
        what = say("more_than_km_away_whose", distance=MAX_DISTANCE / 1000)
        raise bad_pose(file, say("has_camera_pose", what=what))
    pose[:3, :3] = _nearest_rotation(pose[:3, :3], file)
    pose[3] = [0, 0, 0, 1]
    return pose @ OPENGL_TO_OPENCV if axes == "opengl" else pose


def _nearest_rotation(rotation: Floats, file: str) -> Floats:
    """Return the rotation nearest to a nearly orthonormal matrix (3,3), by SVD. Raises CAPTURE_BAD_POSE."""
    off = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if off > 2 * ORTHONORMAL_TOLERANCE:  # an error e in the entries shows as 2e in the product
        raise bad_pose(file, say("has_camera_pose_whose_rotation", off=off))
    if np.linalg.det(rotation) < 0:
        hint = say("export_with_right_handed_axes")
        raise bad_pose(file, say("has_camera_pose_mirrored_axes"), hint)
    if off < _EXACT:
        return rotation
    u, _, vt = np.linalg.svd(rotation)
    nearest: Floats = u @ vt
    return nearest
