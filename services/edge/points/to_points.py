"""Capture -> points: what the field is fitted to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from services.edge.arrays import Tick, no_tick
from services.edge.capture.nouns import Capture
from services.edge.errors import CaptureError
from services.edge.points.aim import around_one_thing
from services.edge.points.cloud import MIN_POINTS, cloud_points
from services.edge.points.fuse import Fused, fuse, windowed
from services.edge.points.isolate import isolate_object
from services.edge.points.nouns import Points
from services.edge.points.odometry import track_frames
from services.edge.points.outliers import inliers
from services.edge.points.shots import sharpest
from services.edge.points.smooth import smoothed
from services.edge.points.unseen import unseen_sides
from services.edge.points.upright import estimate_up, level_up


def to_points(
    capture: Capture, *, voxel: float | None = None, isolate: bool | None = None, tick: Tick = no_tick
) -> Points:
    """Clean, coloured points of a capture, in its frame and units.

    voxel    distance between points in capture units; None: from the depth pixels' size, and a cloud is left as it is
    isolate  keep only the thing in the middle: without what it stands on and what stands around it. None: where photos
             were taken around one thing, and such a thing is found

    Raises CaptureError: CAPTURE_TOO_FEW_POINTS where too little survives, CAPTURE_NOTHING_LEFT where `isolate` finds no
    thing, CAPTURE_NO_POSES where frames without poses cannot be tracked. `tick` may raise `Cancelled`.
    """
    if any(frame.camera_to_world is None for frame in capture.frames):
        posed = _tracked(capture, lambda fraction: tick(0.5 * fraction))
        return to_points(posed, voxel=voxel, isolate=isolate, tick=lambda fraction: tick(0.5 + 0.5 * fraction))
    share = 1.0 if isolate is False else 0.9
    if capture.kind == "points":
        points = cloud_points(capture, voxel=voxel, tick=lambda fraction: tick(share * fraction))
        return isolate_object(points, tick=tick) if isolate else points
    fused = fuse(capture.frames, voxel=voxel, tick=lambda fraction: tick(0.8 * share * fraction))
    points = _rgbd_points(capture, fused, lambda fraction: tick(share * (0.8 + 0.2 * fraction)))
    if isolate is False or (isolate is None and not _of_one_thing(capture)):
        return points
    try:
        thing = isolate_object(points, aim=fused.aim, cameras=fused.cameras, turntable=capture.turntable, tick=tick)
    except CaptureError as error:
        if isolate:
            raise
        return replace(points, warnings=(*points.warnings, f"The surroundings were kept: {error.message}."))
    return replace(thing, unseen=unseen_sides(thing, capture.frames))


def _tracked(capture: Capture, tick: Tick) -> Capture:
    found = track_frames(capture.frames, tick)
    return replace(capture, frames=found.frames, warnings=capture.warnings + found.warnings)


def _of_one_thing(capture: Capture) -> bool:
    """Photos of a thing hold its surroundings too, whether wanted or not; who scans with a depth sensor aims it."""
    return windowed(capture.frames) and around_one_thing(capture.frames)


def _rgbd_points(capture: Capture, fused: Fused, tick: Tick) -> Points:
    stereo = windowed(capture.frames)
    keep = inliers(fused.xyz - fused.cameras[0], (lambda part: tick(0.4 * part)) if stereo else tick)
    if keep.sum() < MIN_POINTS:
        raise CaptureError(
            "CAPTURE_TOO_FEW_POINTS",
            f"{int(keep.sum())} of {len(keep)} fused points are consistent; at least {MIN_POINTS} are needed",
            hints=("Move slowly, in good light, and keep the thing in view.",),
        )
    xyz = fused.xyz[keep]
    if stereo:
        xyz = smoothed(xyz, fused.confidence[keep], lambda part: tick(0.4 + 0.6 * part))
    poses = np.stack([np.asarray(frame.camera_to_world, np.float64) for frame in capture.frames])
    return Points(
        xyz=xyz,
        rgb=None if fused.rgb is None else fused.rgb[keep],
        confidence=fused.confidence[keep],
        metres_per_unit=capture.metres_per_unit,
        scale_confidence=capture.scale_confidence,
        up=estimate_up(poses, xyz) if capture.up is None else level_up(capture.up, xyz),
        warnings=capture.warnings + fused.warnings,
        shots=sharpest(capture.frames, fused.sharpness),
    )
