"""Compute camera poses and sparse points of photos by structure from motion, in a child process.

Where every photo comes with its pose, only the points are triangulated.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from capture2vr.edge.arrays import Floats, Tick, no_tick
from capture2vr.edge.cameras.features import pixel_ratio
from capture2vr.edge.cameras.nouns import Alignment, PhotoView
from capture2vr.edge.cameras.placement_attempts import Attempt, place
from capture2vr.edge.cameras.placement_report import HOW_TO_SHOOT, low_overlap, placement_warnings, verdicts_on
from capture2vr.edge.capture.nouns import MIN_PHOTOS, Photo
from capture2vr.edge.errors import CaptureError
from capture2vr.sentences.sentence import say


def align(photos: Sequence[Photo], *, tick: Tick = no_tick) -> Alignment:
    """Compute cameras and sparse points of photos, in units of the given poses, or else of the first two cameras.

    Where all photos have intrinsics and camera_to_world these are kept, and only the points are triangulated, unless
    the photos contradict them.
    Raises CaptureError CAPTURE_LOW_OVERLAP, EdgeError ALIGN_FAILED, and what `tick` and `Photo.load` raise.
    """
    if len(photos) < MIN_PHOTOS:
        reason = say("capture_has_only_photos_least", count=len(photos), least=MIN_PHOTOS)
        raise CaptureError("CAPTURE_LOW_OVERLAP", reason, hints=(HOW_TO_SHOOT,))
    attempt = place(photos, tick)
    if not attempt.enough:
        raise low_overlap(photos, attempt)
    return _alignment(photos, attempt)


def _alignment(photos: Sequence[Photo], attempt: Attempt) -> Alignment:
    """Convert the solver's answer to an `Alignment`, with verdicts and warnings."""
    answer = attempt.answer
    views = tuple(
        PhotoView(photos[photo], lens.intrinsics, lens.distortion, pose)
        for photo, lens, pose in zip(answer.placed.tolist(), answer.lenses, answer.poses, strict=True)
    )
    return Alignment(
        views,
        answer.xyz,
        answer.seen_point,
        answer.seen_view,
        _error_px(views, attempt),
        verdicts_on(photos, attempt),
        placement_warnings(photos, attempt),
        attempt.contradicted,
    )


def _error_px(views: Sequence[PhotoView], attempt: Attempt) -> float:
    """Return the mean reprojection error, in pixels of the pictures that features were found in."""
    answer = attempt.answer
    distances = []
    for number, view in enumerate(views):
        mine = answer.seen_view == number
        observed = attempt.features[answer.placed[number]].xy[answer.seen_feature[mine]]
        offset = project(view, answer.xyz[answer.seen_point[mine]]) - observed
        distances.append(np.linalg.norm(offset, axis=1) / pixel_ratio(view.photo, attempt.setting.longest))
    return float(np.concatenate(distances).mean())


def project(view: PhotoView, xyz: Floats) -> Floats:
    """Project points (K,3) to pixels (K,2) of the stored photo."""
    at, world_to_camera = view.intrinsics, np.linalg.inv(view.camera_to_world)
    turn, _ = cv2.Rodrigues(world_to_camera[:3, :3])
    matrix = np.array([[at.fx, 0, at.cx], [0, at.fy, at.cy], [0, 0, 1]])
    xy, _ = cv2.projectPoints(xyz, turn, world_to_camera[:3, 3], matrix, np.array(view.distortion))
    return np.asarray(xy, np.float64).reshape(-1, 2)
