"""Find the sides of the object that too few cameras see frontally, and advise from where to take more photos.

The convex hull is used as the surface, since a hollow is visible from the same side as the hull over it. A triangle of
the hull counts as seen by the cameras that have it in their picture within `_FRONTAL_DEG` of its normal. The unseen
triangles are grouped greedily by the direction that shows most of them. The side that the object stands on is ignored.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from capture2vr.edge.arrays import Bools, Floats
from capture2vr.edge.capture.nouns import Frame
from capture2vr.edge.points.nouns import Points, UnseenSide
from capture2vr.sentences.sentence import say

_FRONTAL_DEG = 65.0
"""Largest angle between a normal and the direction to a camera: beyond it pixels cover twice their width or more."""
_ENOUGH = 2
"""Cameras that must see a triangle: one camera gives no depth by itself, and may be blurred."""
_LOWEST_DEG = -20.0
"""Elevation of normals below which a surface faces the ground that the object stands on."""
_REACHABLE_DEG = -10.0
"""Elevation below which nobody holds a phone."""
_LEAST = 0.06
"""Least share of the surface that is worth advice: noise of the hull stays below it."""
_MOST = 3
"""Most pieces of advice: people follow no more."""
_PROBES = 400
"""Directions tried, 7 degrees apart."""
_POINTS = 20_000
"""Points that the hull is computed from, at most."""
_ABOVE_DEG = 60.0
"""Elevation from which on the advice is "from above"."""
_OTHER_HEIGHT_DEG = 12.0
"""Degrees beyond the lowest or highest camera that people notice as another height."""
_SIDES = (
    say("side_front"),
    say("side_front_right"),
    say("side_right"),
    say("behind_on_right"),
    say("side_behind"),
    say("behind_on_left"),
    say("side_left"),
    say("side_front_left"),
)
"""Names of the directions as seen in the first picture, in steps of 45 degrees."""


def unseen_sides(points: Points, frames: Sequence[Frame]) -> tuple[UnseenSide, ...]:
    """Return at most `_MOST` badly seen sides, the largest first; none where all are seen well or `up` is unknown.

    points: of the isolated object; frames: with poses, in the same frame and units.
    """
    if points.up is None:
        return ()
    up = np.asarray(points.up, np.float64)
    middle, normal, area = _hull(points.xyz)
    counts = normal @ up > np.sin(np.radians(_LOWEST_DEG))
    unseen = counts & (_cameras(middle, normal, frames) < _ENOUGH)
    whole = float(area[counts].sum())
    centre = points.xyz.mean(axis=0)
    probes = _directions(up)
    found: list[UnseenSide] = []
    while len(found) < _MOST and unseen.any():
        facing = normal @ probes.T > np.cos(np.radians(_FRONTAL_DEG))
        share = (area * unseen) @ facing / whole
        best = int(share.argmax())
        if share[best] < _LEAST:
            break
        shown = unseen & facing[:, best]
        toward = _reachable((area * shown) @ normal, up)
        advice = _advice(toward, up, frames, centre, float(share[best]))
        found.append(UnseenSide(advice, (float(toward[0]), float(toward[1]), float(toward[2])), float(share[best])))
        unseen = unseen & ~shown
    return tuple(found)


def _hull(xyz: Floats) -> tuple[Floats, Floats, Floats]:
    """Compute the convex hull: centres (F,3), outward unit normals (F,3) and areas (F,) of its triangles."""
    from scipy.spatial import ConvexHull, QhullError

    some = xyz[np.random.default_rng(0).permutation(len(xyz))[:_POINTS]]
    try:
        hull = ConvexHull(some)
    except QhullError:  # of points in one plane, as of a poster at one depth
        hull = ConvexHull(some, qhull_options="QJ")
    corners = some[hull.simplices]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return corners.mean(axis=1), hull.equations[:, :3], np.linalg.norm(across, axis=1) / 2


def _cameras(middle: Floats, normal: Floats, frames: Sequence[Frame]) -> Floats:
    """Count for each triangle of the hull the cameras that see it frontally (F,)."""
    seen = np.zeros(len(middle))
    for frame in frames:
        pose = np.asarray(frame.camera_to_world, np.float64)
        back = pose[:3, 3] - middle
        frontal = np.einsum("fi,fi->f", back, normal) > np.cos(np.radians(_FRONTAL_DEG)) * np.linalg.norm(back, axis=1)
        seen += frontal & _in_picture(middle, frame, pose)
    return seen


def _in_picture(xyz: Floats, frame: Frame, pose: Floats) -> Bools:
    """Return a mask (N,): True for points that project into the frame's image."""
    camera = frame.intrinsics
    x, y, z = pose[:3, :3].T @ (xyz - pose[:3, 3]).T
    safe = np.where(z > 0, z, 1)
    u, v = x / safe * camera.fx + camera.cx, y / safe * camera.fy + camera.cy
    inside: Bools = (z > 0) & (u >= 0) & (u <= camera.width - 1) & (v >= 0) & (v <= camera.height - 1)
    return inside


def _directions(up: Floats) -> Floats:
    """Return unit vectors (P,3), spread evenly (sunflower spiral) over the directions where a camera can be."""
    lowest = np.sin(np.radians(_REACHABLE_DEG))
    rise = lowest + (1 - lowest) * (np.arange(_PROBES) + 0.5) / _PROBES
    turn = np.arange(_PROBES) * np.pi * (3 - np.sqrt(5))
    flat = np.sqrt(1 - rise**2)
    east, north = np.linalg.svd(up[None])[2][1:]
    return np.outer(flat * np.cos(turn), east) + np.outer(flat * np.sin(turn), north) + np.outer(rise, up)


def _reachable(direction: Floats, up: Floats) -> Floats:
    """Normalise a direction (3,), and raise it to the lowest elevation at which somebody can hold a phone."""
    unit = direction / np.linalg.norm(direction)
    lowest = np.sin(np.radians(_REACHABLE_DEG))
    if unit @ up >= lowest:
        return np.asarray(unit)
    level = unit - (unit @ up) * up
    raised: Floats = np.sqrt(1 - lowest**2) * level / max(float(np.linalg.norm(level)), 1e-12) + lowest * up
    return raised / np.linalg.norm(raised)


def _advice(toward: Floats, up: Floats, frames: Sequence[Frame], centre: Floats, share: float) -> str:
    """Return the advice, such as "Shoot from behind, higher up: …"; sides are as seen in the first picture."""
    reason = say("thing_seen_too_little", share=share)
    rise = _elevation(toward, up)
    if rise > _ABOVE_DEG:
        return say("shoot_from_above", reason=reason)
    first = np.asarray(frames[0].camera_to_world, np.float64)
    # "Front" is towards the camera; for a picture from above, towards its lower edge.
    front = _level(-first[:3, 2] + 0.2 * first[:3, 1], up)
    right = np.cross(up, front)
    side = _SIDES[round(float(np.degrees(np.arctan2(toward @ right, toward @ front))) / 45) % 8]
    eyes = [np.asarray(frame.camera_to_world, np.float64)[:3, 3] - centre for frame in frames]
    rises = [_elevation(eye / np.linalg.norm(eye), up) for eye in eyes]
    if rise > max(rises) + _OTHER_HEIGHT_DEG:
        side = say("higher_up", side=side)
    elif rise < min(rises) - _OTHER_HEIGHT_DEG:
        side = say("lower_down", side=side)
    return say("shoot_from_as_seen", side=side, reason=reason)


def _elevation(direction: Floats, up: Floats) -> float:
    """Return the elevation of a unit vector above the horizon, in degrees."""
    return float(np.degrees(np.arcsin(np.clip(direction @ up, -1, 1))))


def _level(direction: Floats, up: Floats) -> Floats:
    """Return the horizontal part of a direction as a unit vector."""
    level: Floats = direction - (direction @ up) * up
    return level / max(float(np.linalg.norm(level)), 1e-12)
