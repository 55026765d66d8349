"""Give every depth frame a pose: the given one where the images agree, or else a tracked one, or the pictures'."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from capture2vr.edge.arrays import Tick, no_tick
from capture2vr.edge.cameras.place_frames import place_frames
from capture2vr.edge.capture.frame_records import MAX_BAD_SHARE, as_warnings
from capture2vr.edge.capture.nouns import MIN_PHOTOS, Capture
from capture2vr.edge.errors import CaptureError, EdgeError
from capture2vr.edge.odometry.check_poses import pose_fault
from capture2vr.edge.odometry.tracker import track_frames
from capture2vr.sentences.sentence import capitalised, say

_TRACKING = 0.6  # share of the progress that tracking takes, where structure from motion follows
_ASTRAY = 20.0  # times the cameras' usual distance from their middle, and a metre


def with_poses(capture: Capture, tick: Tick = no_tick) -> Capture:
    """Return an RGB-D capture whose frames all have poses that their images do not contradict.

    Raises CaptureError: CAPTURE_NO_POSES where there are no poses and none can be computed, CAPTURE_BAD_POSE where the
    given ones contradict the images and no others can be computed. `tick` may raise `Cancelled`.
    """
    if any(frame.camera_to_world is None for frame in capture.frames):
        return _tracked(capture, tick)
    capture = _without_strays(capture)
    fault = pose_fault(capture.frames)
    if fault is None:
        return capture
    try:
        tracked = _tracked(replace(capture, up=None), tick)
    except CaptureError as error:
        reason = say("they_could_not_be_computed", fault=fault, why=error.message)
        hint = say("check_each_pose_belongs")
        raise CaptureError("CAPTURE_BAD_POSE", reason, file=error.file, hints=(hint, *error.hints)) from None
    sentence = say("they_not_used_camera_way", fault=capitalised(fault))
    return replace(tracked, warnings=(*capture.warnings, sentence, *tracked.warnings[len(capture.warnings) :]))


def _without_strays(capture: Capture) -> Capture:
    """Leave out the few frames whose camera is far away from all others: one such pose makes a room of a cup."""
    eyes = np.stack([np.asarray(frame.camera_to_world, np.float64)[:3, 3] for frame in capture.frames])
    away_m = np.linalg.norm(eyes - np.median(eyes, axis=0), axis=1)
    limit_m = _ASTRAY * (1 + np.median(away_m))
    astray = away_m > limit_m
    if not 0 < astray.sum() <= max(1, MAX_BAD_SHARE * len(eyes)):
        return capture
    leaps_m = np.linalg.norm(eyes[astray, None] - eyes[~astray], axis=2)
    if leaps_m.min() < limit_m / 2:  # somebody walked there
        return capture
    errors = [
        CaptureError("CAPTURE_BAD_POSE", say("has_camera_pose_m", distance=away), file=frame.name)
        for frame, away, stray in zip(capture.frames, away_m, astray, strict=True)
        if stray
    ]
    frames = tuple(frame for frame, stray in zip(capture.frames, astray, strict=True) if not stray)
    return replace(capture, frames=frames, warnings=(*capture.warnings, *as_warnings(say("frame_skipped"), errors)))


def _tracked(capture: Capture, tick: Tick) -> Capture:
    """Track the camera's way by the depth, or where that fails, compute it from the pictures."""
    try:
        tracked = track_frames(capture.frames, lambda fraction: tick(_TRACKING * fraction))
        return replace(capture, frames=tracked.frames, warnings=capture.warnings + tracked.warnings)
    except CaptureError as error:
        pictures = sum(frame.load_rgb is not None for frame in capture.frames)
        if error.code != "CAPTURE_NO_POSES" or pictures < MIN_PHOTOS:
            raise
        try:
            frames, warnings = place_frames(capture.frames, lambda part: tick(_TRACKING + (1 - _TRACKING) * part))
        except EdgeError as other:
            hints = (*error.hints, say("pictures_could_not_be_aligned", why=other.message))
            raise CaptureError(error.code, error.message, file=error.file, hints=hints) from None
        lost = say("camera_way_could", file=error.file, count=len(frames), pictures=pictures)
        return replace(capture, frames=frames, warnings=(*capture.warnings, lost, *warnings))
