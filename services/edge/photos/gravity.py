"""Find which way is up from what the photos' metadata say of gravity, once the photos have poses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.cameras.nouns import PhotoView
from capture2vr.edge.capture.nouns import UpSource, certainty

_LEAST_PHOTOS = 3
"""Photos that must tell gravity: fewer cannot contradict each other."""
_SENSOR_DEG = 0.5
"""Error that the photos' sensors share: how a phone's accelerometer is mounted and calibrated."""
_DISAGREE_DEG = 10.0
"""Largest median angle between the photos' directions and their mean. More means pictures that were rotated after they
were taken, or a front camera; a hand that moves while it photographs adds 1 to 3 degrees."""
_HELD = 0.02
"""Weight of how the cameras were held against their elevation angles, which alone leave a direction open where all
cameras are level."""


def gravity_up(views: Sequence[PhotoView]) -> tuple[Floats, UpSource] | None:
    """Return the unit vector (3,) against gravity in the frame of the poses, and how sure it is; None where too few
    photos tell it, or where they contradict each other."""
    return _from_accelerations(views) or _from_elevations(views)


def _from_accelerations(views: Sequence[PhotoView]) -> tuple[Floats, UpSource] | None:
    """Average the directions that accelerometers measured."""
    known = [(view.camera_to_world[:3, :3], view.photo.up_in_camera) for view in views]
    ups = [rotation @ up for rotation, up in known if up is not None]
    return _agreed(np.stack(ups)) if len(ups) >= _LEAST_PHOTOS else None


def _agreed(ups: Floats) -> tuple[Floats, UpSource] | None:
    """Return the mean of unit vectors (N,3), a few of which may be wrong, and its certainty."""
    up = _unit(np.median(ups, axis=0))
    away = np.degrees(np.arccos(np.clip(ups @ up, -1, 1)))
    near = away <= _DISAGREE_DEG
    if np.median(away) > _DISAGREE_DEG or near.sum() < _LEAST_PHOTOS:
        return None
    error_deg = _SENSOR_DEG + float(np.median(away)) / np.sqrt(near.sum())
    return _unit(ups[near].mean(axis=0)), UpSource("gravity", certainty(error_deg))


def _from_elevations(views: Sequence[PhotoView]) -> tuple[Floats, UpSource] | None:
    """Solve for the direction that puts every camera's optical axis at its elevation over the horizon."""
    told = [(view, view.photo.elevation_deg) for view in views if view.photo.elevation_deg is not None]
    if len(told) < _LEAST_PHOTOS:
        return None
    ahead = np.stack([view.camera_to_world[:3, 2] for view, _ in told])
    rise = np.sin(np.radians([elevation for _, elevation in told]))
    held = _unit(np.mean([_image_up(view) for view, _ in told], axis=0))
    weight = _HELD * np.sqrt(len(told))
    rows, values = np.concatenate([ahead, weight * np.eye(3)]), np.concatenate([rise, weight * held])
    up = _unit(np.linalg.lstsq(rows, values, rcond=None)[0])
    missed = np.degrees(np.abs(np.arcsin(np.clip(ahead @ up, -1, 1)) - np.arcsin(rise)))
    if np.median(missed) > _DISAGREE_DEG:
        return None
    # Elevations hold the direction where the cameras look to different sides; else only how they were held does.
    spread = float(np.linalg.svd(ahead - ahead.mean(axis=0), compute_uv=False)[1] / np.sqrt(len(told)))
    error_deg = _SENSOR_DEG + float(np.median(missed)) / (np.sqrt(len(told)) * max(spread, 1e-6))
    return up, UpSource("gravity", certainty(error_deg))


def _image_up(view: PhotoView) -> Floats:
    """Return the direction (3,) that is up in the upright picture, in the frame of the poses."""
    sides = [[0.0, -1, 0], [-1, 0, 0], [0, 1, 0], [1, 0, 0]]  # of the stored picture, by its turns
    up: Floats = view.camera_to_world[:3, :3] @ np.array(sides[view.photo.turns])
    return up


def _unit(vector: Floats) -> Floats:
    unit: Floats = vector / max(float(np.linalg.norm(vector)), 1e-12)
    return unit
