"""Decide from camera poses and depth whether somebody walked around one object, or looked around in a room."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.nouns import Frame
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.fusion.fuse import has_stereo_depth
from capture2vr.sentences.sentence import say

_MISSED_BY = 0.25
"""Largest median distance of the optical axes from their meeting point, over the median distance of the cameras from
it. Around an object that fills the picture it is 0.02 to 0.15; for cameras that look outward from the middle of a room,
the point is behind half of them."""
_IN_FRONT = 0.9
"""Share of the cameras that must have the point in front of them."""
_PARALLEL = 0.9
"""Length of the mean of the optical axes from which on they are nearly parallel: half of them within 25 degrees."""
_BEYOND = 1.5
"""Largest depth of what is seen in the middle of the pictures, over the distance to where the axes meet. An object
there is nearer than its middle; seen across a room, the opposite wall is at least twice as far away."""
_ASIDE = 0.2
"""How far from the box around what was cut out the photos may aim, over the distance of the cameras."""
_NEAREST = 10
"""Percentile of the depth in the middle of a picture: a lamp on its pole covers little of it."""
_ASKED = 24
"""Most frames whose depth is looked at: their median does not change with more."""
_ROUNDS = 10
"""Rounds of reweighted least squares."""


def sees_a_scene(frames: Sequence[Frame]) -> str:
    """Return why posed frames show a scene and not one object, as a sentence; "" for photos taken around one object.

    Photos show the surroundings whether they are wanted or not; a depth sensor is pointed at what is wanted.
    """
    if not has_stereo_depth(frames):
        return say("depth_sensor_pointed_what_wanted")
    eyes, axes = _eyes_and_axes(frames)
    point = aimed_at(frames)
    if point is None:
        if np.linalg.norm(axes.mean(axis=0)) > _PARALLEL:
            return say("cameras_look_past_each_other")
        return say("cameras_look_outward")
    if _depth_of_middle(frames, np.einsum("ni,ni->n", point - eyes, axes)) > _BEYOND:
        return say("cameras_look_across_room_nothing")
    return ""


def aimed_at(frames: Sequence[Frame]) -> Floats | None:
    """Return the point (3,) that posed frames aim at, where their optical axes meet; None where they do not."""
    eyes, axes = _eyes_and_axes(frames)
    point = meeting_point(eyes, axes)
    away = np.einsum("ni,ni->n", point - eyes, axes)
    missed = np.linalg.norm(point - eyes - away[:, None] * axes, axis=1)
    meet = np.mean(away > 0) >= _IN_FRONT and np.median(missed) < _MISSED_BY * np.median(away)
    return point if meet else None


def sure_aim(frames: Sequence[Frame]) -> Floats | None:
    """Return the point (3,) that photos aim at, where they turn far enough around it to tell how far away it is."""
    nearly_parallel = np.linalg.norm(_eyes_and_axes(frames)[1].mean(axis=0)) > _PARALLEL
    return None if nearly_parallel or not has_stereo_depth(frames) else aimed_at(frames)


def require_aim(thing: Floats, aim: Floats, eyes: Floats) -> None:
    """Raise CaptureError CAPTURE_NOTHING_LEFT where points (N,3) that were cut out are not what cameras (M,3) aim at.

    A black, shiny or transparent object gives no depth, and what stands behind it does.
    """
    outside = np.maximum(np.maximum(thing.min(axis=0) - aim, aim - thing.max(axis=0)), 0)
    if np.linalg.norm(outside) > _ASIDE * np.median(np.linalg.norm(eyes - aim, axis=1)):
        hints = (say("again_matt"), say("keep_thing_in_middle_picture"))
        raise CaptureError("CAPTURE_NOTHING_LEFT", say("aimed_at_gave_no_depth"), hints=hints)


def _eyes_and_axes(frames: Sequence[Frame]) -> tuple[Floats, Floats]:
    """Positions (N,3) and optical axes (N,3) of the frames' cameras."""
    poses = np.stack([np.asarray(frame.camera_to_world, np.float64) for frame in frames])
    return poses[:, :3, 3], poses[:, :3, 2]


def _depth_of_middle(frames: Sequence[Frame], away: Floats) -> float:
    """Return the median depth of what stands in the middle third of the pictures, over the distances `away` (N,) to
    where the axes meet; 0 where nothing has depth."""
    ratios = []
    for number in np.unique(np.linspace(0, len(frames) - 1, _ASKED).astype(int)):
        depth = frames[number].load_depth_m()
        rows, columns = depth.shape[0] // 3, depth.shape[1] // 3
        middle = depth[rows : depth.shape[0] - rows, columns : depth.shape[1] - columns]
        if (middle > 0).any() and away[number] > 0:
            ratios.append(float(np.percentile(middle[middle > 0], _NEAREST) / away[number]))
    return float(np.median(ratios)) if ratios else 0.0


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
