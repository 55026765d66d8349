"""Estimate the up direction of a capture: the surest of what is known of it, and how sure that is.

In this order, the first that is sure enough: the capture's own (an app's sensors, the photos' metadata, a turntable's
axis), vertical lines in the pictures, the plane of the cameras' way, a floor or a table, how the cameras were held.
What is not sure turns nothing: a relief on a wall, or a desk that slopes, stays as the pictures show it.
"""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.nouns import Capture, UpSource, certainty
from capture2vr.edge.points.plane import largest_plane
from capture2vr.edge.points.vertical_lines import vertical_lines

SURE = 0.7
"""Confidence from which on a source is believed without asking the next one: an expected error of three degrees."""
_NEARLY_LEVEL_DEG = 10.0
"""Largest tilt of a plane that is believed to be level. Of a statue's up, the largest plane in sight was 7 degrees off,
the cameras 1, the plane below the pedestal less."""
_UNPANNED_DEG = 45.0
"""The same about the cameras' horizontal axis, where they hardly turned: people look down at what lies on a table, by
40 degrees on average where they go from low before it to high over it."""
_KNOWN_TILT_DEG = 5.0
"""The same for an up direction given by the capture: sensors are within 1 degree."""
_FLOOR_SHARE = 0.12
"""Least share of the points on a floor or table."""
_FLOOR_REACH = 0.01
"""Distance from a plane within which points belong to it, as a share of the points' extent."""
_PANNED_DEG = 20.0
"""Least rotation of the cameras about the vertical, for their horizontal axes to define the horizon."""
_HELD, _GUESSED = 0.5, 0.2
"""Confidence of how cameras were held, which turned about a thing or hardly turned."""
_LEAN_DEG, _UNPANNED_LEAN_DEG = 5.0, 15.0
"""Largest angle of vertical lines to how cameras were held that turned about a thing, or hardly turned: lines farther
off are edges of a thing that leans."""
_WALK_DEG = 20.0
"""Largest angle between the plane of a walk and the horizon of the cameras on it: a turn over the thing has more."""
_ROUND_WALK = 0.25
"""Least width of a walk over its length: the plane of a straight one is open."""
_STEPS = 3.0
"""Photos to a step of the hand's height, which rises and sinks slowly: fewer heights are independent than photos."""


def find_up(capture: Capture, xyz: Floats) -> tuple[Floats, UpSource]:
    """Find the unit vector (3,) against gravity, from a capture's posed frames and its points (N,3), and its source."""
    if capture.up is not None and capture.up_source.confidence >= SURE:
        return level_up(capture.up, xyz), capture.up_source
    poses = np.stack([np.asarray(frame.camera_to_world, np.float64) for frame in capture.frames])
    held, how = from_cameras(poses)
    lean_deg = _LEAN_DEG if how.confidence >= _HELD else _UNPANNED_LEAN_DEG
    for found in (vertical_lines(capture.frames, held, lean_deg), from_walk(poses[:, :3, 3], held)):
        if found is not None and found[1].confidence >= SURE:
            return found
    return from_floor(poses, held, xyz) or (held, how)


def from_cameras(poses: Floats) -> tuple[Floats, UpSource]:
    """Estimate the up direction (3,) from how the cameras of poses (M,4,4) were held.

    People hold cameras level, so the cameras' x axes lie in the ground plane; if the cameras hardly turned, their mean
    up is taken instead.
    """
    right, image_up = poses[:, :3, 0], -poses[:, :3, 1]
    mean_up = image_up.sum(axis=0)
    length = float(np.linalg.norm(mean_up))
    if _is_panned(right):
        vertical = np.linalg.eigh(right.T @ right)[1][:, 0]
        return vertical * np.sign(vertical @ mean_up or 1.0), UpSource("cameras", _HELD)
    return (mean_up / length if length > 0 else np.array([0.0, 1.0, 0.0])), UpSource("cameras", _GUESSED)


def _is_panned(right: Floats) -> bool:
    """Return whether the cameras' x axes (M,3) turn enough about the vertical to define the horizon."""
    # The middle eigenvalue is the mean squared sine of the rotation about the vertical.
    spread = np.linalg.eigvalsh(right.T @ right / len(right))[1]
    return bool(spread > np.sin(np.radians(_PANNED_DEG)) ** 2 / 4)


def from_walk(eyes: Floats, held: Floats) -> tuple[Floats, UpSource] | None:
    """Return the normal (3,) of the plane of cameras (M,3) whom somebody carried around at one height; None where their
    way is straight, or goes over the thing. held (3,): roughly up."""
    _, size, axes = np.linalg.svd(eyes - eyes.mean(axis=0))
    normal: Floats = axes[2] * np.sign(axes[2] @ held or 1.0)
    if len(eyes) < 3 or size[1] < _ROUND_WALK * size[0] or normal @ held < np.cos(np.radians(_WALK_DEG)):
        return None
    lean_deg = float(np.degrees(np.arctan2(size[2], size[1])))
    return normal, UpSource("walk", certainty(lean_deg / np.sqrt(max(1.0, len(eyes) / _STEPS - 2))))


def from_floor(poses: Floats, held: Floats, xyz: Floats) -> tuple[Floats, UpSource] | None:
    """Detect a nearly level floor or table in the points (N,3): return its normal (3,), or None.

    held (3,): up, as the cameras were held. Cameras that hardly turned leave open how far they looked down, so that a
    table may be farther from it, but only about their horizontal axis.
    """
    right = poses[:, :3, 0]
    panned = _is_panned(right)
    within_deg = _NEARLY_LEVEL_DEG if panned else _UNPANNED_DEG
    normal = _large_plane(xyz, held, within_deg)
    if normal is None:
        return None
    rolled = abs(float(np.mean(right @ normal))) > np.sin(np.radians(_NEARLY_LEVEL_DEG))
    return None if rolled and not panned else (normal, plane_source(normal, held))


def plane_source(normal: Floats, up: Floats) -> UpSource:
    """Return how sure a plane's normal (3,) is, by how far it is from what else is known to be up (3,)."""
    away_deg = float(np.degrees(np.arccos(np.clip(normal @ up, -1, 1))))
    return UpSource("plane", certainty(away_deg / 4))


def level_with(normal: Floats, up: Floats, source: UpSource | None) -> tuple[Floats, UpSource | None]:
    """Choose the up direction (3,): the supporting plane's normal, if it agrees with a surer estimate of up.

    up (3,): as known so far, from `source`.
    """
    within_deg = _NEARLY_LEVEL_DEG
    if source is not None and source.teller not in ("plane", "cameras"):
        within_deg = source.error_deg
    if normal @ up < np.cos(np.radians(within_deg)):
        return up, source
    found = plane_source(normal, up)
    if source is not None and source.teller == "plane":  # two planes are often one: that they agree makes neither surer
        found = UpSource("plane", min(found.confidence, source.confidence))
    return normal, found


def level_up(up: Floats, xyz: Floats) -> Floats:
    """Return the normal (3,) of a floor or table in the points (N,3) that is very near `up`; without one `up`."""
    normal = _large_plane(xyz, up, _KNOWN_TILT_DEG)
    return up if normal is None else normal


def _large_plane(xyz: Floats, up: Floats, within_deg: float) -> Floats | None:
    """Return the normal (3,) of a large plane in the points (N,3) within this angle of `up`."""
    low, high = np.percentile(xyz, [2, 98], axis=0)
    floor = largest_plane(xyz - low, _FLOOR_REACH * float((high - low).max()), along=up, within_deg=within_deg)
    return floor.normal if floor is not None and floor.share > _FLOOR_SHARE else None
