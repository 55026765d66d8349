"""From where to shoot again: the sides of the thing that too few cameras looked at from in front.

The thing's convex hull stands for its surface: what lies in a hollow is looked into from the same side. A cell of the
hull is seen by the cameras that have it in their picture within `_FRONTAL_DEG` of its normal. What is left unseen is
gathered into the directions that show most of it. The side that the thing stands on does not count.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from services.edge.arrays import Bools, Floats
from services.edge.capture.nouns import Frame
from services.edge.points.nouns import Points, Unseen

_FRONTAL_DEG = 65.0
"""Between a surface's normal and the way to a camera: beyond it pixels are stretched to twice their width and more."""
_ENOUGH = 2
"""Cameras that must see a cell: one gives no depth by itself, and is soon blurred."""
_LOWEST_DEG = -20.0
"""Elevation of normals below which a surface faces what the thing stands on."""
_REACHABLE_DEG = -10.0
"""Elevation below which nobody holds a phone."""
_LEAST = 0.06
"""Share of the surface that is worth another round: what noise makes of a hull is below."""
_MOST = 3
"""Pieces of advice that a person follows."""
_PROBES = 400
"""Directions tried, 7 degrees apart."""
_POINTS = 20_000
"""Enough for a hull."""
_ABOVE_DEG = 60.0
_OTHER_HEIGHT_DEG = 12.0
"""Beyond the lowest and highest camera: what people notice as another height."""
_SIDES = (
    "the front",
    "the front right",
    "the right",
    "behind on the right",
    "behind",
    "behind on the left",
    "the left",
    "the front left",
)
"""As somebody sees them who took the first picture, in steps of 45 degrees."""


def unseen_sides(points: Points, frames: Sequence[Frame]) -> tuple[Unseen, ...]:
    """At most `_MOST`, the largest first; none where the thing is seen well all round or nothing tells which way is up.

    points: of the thing alone; frames: with poses, in the same frame and units.
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
    found: list[Unseen] = []
    while len(found) < _MOST and unseen.any():
        facing = normal @ probes.T > np.cos(np.radians(_FRONTAL_DEG))
        share = (area * unseen) @ facing / whole
        best = int(share.argmax())
        if share[best] < _LEAST:
            break
        shown = unseen & facing[:, best]
        toward = _reachable((area * shown) @ normal, up)
        told = _sentence(toward, up, frames, centre, float(share[best]))
        found.append(Unseen(told, (float(toward[0]), float(toward[1]), float(toward[2])), float(share[best])))
        unseen = unseen & ~shown
    return tuple(found)


def _hull(xyz: Floats) -> tuple[Floats, Floats, Floats]:
    """Middles (F,3), outward unit normals (F,3) and areas (F,) of the hull's triangles."""
    from scipy.spatial import ConvexHull

    some = xyz[np.random.default_rng(0).permutation(len(xyz))[:_POINTS]]
    hull = ConvexHull(some)
    corners = some[hull.simplices]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return corners.mean(axis=1), hull.equations[:, :3], np.linalg.norm(across, axis=1) / 2


def _cameras(middle: Floats, normal: Floats, frames: Sequence[Frame]) -> Floats:
    """(F,) number of the cameras that see each cell from in front."""
    seen = np.zeros(len(middle))
    for frame in frames:
        pose = np.asarray(frame.camera_to_world, np.float64)
        back = pose[:3, 3] - middle
        frontal = np.einsum("fi,fi->f", back, normal) > np.cos(np.radians(_FRONTAL_DEG)) * np.linalg.norm(back, axis=1)
        seen += frontal & _in_picture(middle, frame, pose)
    return seen


def _in_picture(xyz: Floats, frame: Frame, pose: Floats) -> Bools:
    camera = frame.intrinsics
    x, y, z = pose[:3, :3].T @ (xyz - pose[:3, 3]).T
    safe = np.where(z > 0, z, 1)
    u, v = x / safe * camera.fx + camera.cx, y / safe * camera.fy + camera.cy
    inside: Bools = (z > 0) & (u >= 0) & (u <= camera.width - 1) & (v >= 0) & (v <= camera.height - 1)
    return inside


def _directions(up: Floats) -> Floats:
    """(P,3) unit vectors spread evenly (a sunflower's spiral) over where a camera can be."""
    lowest = np.sin(np.radians(_REACHABLE_DEG))
    rise = lowest + (1 - lowest) * (np.arange(_PROBES) + 0.5) / _PROBES
    turn = np.arange(_PROBES) * np.pi * (3 - np.sqrt(5))
    flat = np.sqrt(1 - rise**2)
    east, north = np.linalg.svd(up[None])[2][1:]
    return np.outer(flat * np.cos(turn), east) + np.outer(flat * np.sin(turn), north) + np.outer(rise, up)


def _reachable(direction: Floats, up: Floats) -> Floats:
    """The direction (3,) as a unit vector, no lower than somebody can hold a phone."""
    unit = direction / np.linalg.norm(direction)
    lowest = np.sin(np.radians(_REACHABLE_DEG))
    if unit @ up >= lowest:
        return np.asarray(unit)
    level = unit - (unit @ up) * up
    raised: Floats = np.sqrt(1 - lowest**2) * level / max(float(np.linalg.norm(level)), 1e-12) + lowest * up
    return raised / np.linalg.norm(raised)


def _sentence(toward: Floats, up: Floats, frames: Sequence[Frame], centre: Floats, share: float) -> str:
    """As "Shoot from behind, higher up: …", sides as the first picture has them."""
    told = f"{share:.0%} of the thing is seen too little"
    rise = _elevation(toward, up)
    if rise > _ABOVE_DEG:
        return f"Shoot from above: {told}."
    first = np.asarray(frames[0].camera_to_world, np.float64)
    # Towards the camera, which for pictures from above is where their lower edge is.
    front = _level(-first[:3, 2] + 0.2 * first[:3, 1], up)
    right = np.cross(up, front)
    side = _SIDES[round(float(np.degrees(np.arctan2(toward @ right, toward @ front))) / 45) % 8]
    eyes = [np.asarray(frame.camera_to_world, np.float64)[:3, 3] - centre for frame in frames]
    rises = [_elevation(eye / np.linalg.norm(eye), up) for eye in eyes]
    height = ""
    if rise > max(rises) + _OTHER_HEIGHT_DEG:
        height = ", higher up"
    elif rise < min(rises) - _OTHER_HEIGHT_DEG:
        height = ", lower down"
    return f"Shoot from {side}{height}, as seen in the first picture: {told}."


def _elevation(direction: Floats, up: Floats) -> float:
    """Degrees above the horizon of a unit vector."""
    return float(np.degrees(np.arcsin(np.clip(direction @ up, -1, 1))))


def _level(direction: Floats, up: Floats) -> Floats:
    level: Floats = direction - (direction @ up) * up
    return level / max(float(np.linalg.norm(level)), 1e-12)
