"""Place depth frames by structure from motion on their pictures, with their depth for the scale.

For frames whose camera's way cannot be tracked by depth: they are too far apart, or what they show could slide.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from capture2vr.edge.arrays import Bytes, Floats, Tick, evenly, no_tick
from capture2vr.edge.cameras.nouns import Alignment, PhotoView
from capture2vr.edge.cameras.parallax import require_parallax
from capture2vr.edge.cameras.structure_from_motion import align, project
from capture2vr.edge.capture.frame_records import as_warnings
from capture2vr.edge.capture.nouns import Frame, Photo
from capture2vr.edge.errors import CaptureError
from capture2vr.sentences.sentence import say

_MOST_FRAMES = 60  # as of a film: more cost seconds each, and made the cameras no more exact
_ALIKE = 0.1  # relative difference from the scale within which depth and a point agree: a phone's depth errs by 2 %
_AGREEING = 0.5  # least share of the points that agree; silhouettes and what the sensor does not see take a third
_FEWEST = 50  # points whose depth is known, for the scale


@dataclass(frozen=True, slots=True)
class _FramePicture:
    """A frame's picture as `LoadPhoto`: decoded, and shrunk where that is wanted."""

    load_rgb: Callable[[], Bytes]

    def __call__(self, longest: int | None = None) -> Bytes:
        rgb = self.load_rgb()
        shrink = min(1.0, (longest or max(rgb.shape)) / max(rgb.shape))
        if shrink == 1.0:
            return rgb
        return np.asarray(cv2.resize(rgb, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA), np.uint8)


def place_frames(frames: Sequence[Frame], tick: Tick = no_tick) -> tuple[tuple[Frame, ...], tuple[str, ...]]:
    """Compute the poses of up to _MOST_FRAMES evenly spaced frames, in metres -> those placed, and warnings.

    Frames whose picture cannot be decoded are left out; depth that cannot be decoded says nothing of the scale.
    Raises CaptureError: CAPTURE_LOW_OVERLAP and CAPTURE_DEGENERATE as of photos, CAPTURE_NO_POSES where the depth does
    not agree with the pictures; EdgeError ALIGN_FAILED.
    """
    pictured = [frame for frame in frames if frame.load_rgb is not None]
    by_name = {frame.name: frame for frame in evenly(pictured, _MOST_FRAMES)}
    photos: list[Photo] = []
    damaged: list[CaptureError] = []
    for frame in by_name.values():
        try:
            photos.append(_photo(frame))
        except CaptureError as error:
            damaged.append(error)
    alignment = align(photos, tick=tick)
    require_parallax(alignment)
    chosen = [by_name[view.photo.name] for view in alignment.views]
    metres = _metres_per_unit(alignment, chosen)
    placed = (replace(frame, camera_to_world=_scaled(view, metres))
              for frame, view in zip(chosen, alignment.views, strict=True))  # fmt: skip
    return tuple(placed), (*as_warnings(say("frame_skipped"), damaged), *alignment.warnings)


def _photo(frame: Frame) -> Photo:
    """Make a photo of a frame's picture; all share one camera, whose focal length is known."""
    assert frame.load_rgb is not None
    height, width = frame.load_rgb().shape[:2]
    focal = frame.intrinsics.scaled_to(width, height).fx
    return Photo(frame.name, (width, height), f"{width} x {height}", _FramePicture(frame.load_rgb), focal)


def _scaled(view: PhotoView, metres: float) -> Floats:
    pose = view.camera_to_world.copy()
    pose[:3, 3] *= metres
    return pose


def _metres_per_unit(alignment: Alignment, frames: Sequence[Frame]) -> float:
    """Return the median, over the points that the frames see, of measured depth over computed depth."""
    ratios = np.concatenate([_depth_ratios(alignment, number, frame) for number, frame in enumerate(frames)])
    metres = float(np.median(ratios)) if len(ratios) >= _FEWEST else 0.0
    if not metres or np.mean(np.abs(ratios / metres - 1) < _ALIKE) < _AGREEING:
        reason = say("pictures_can_be_aligned")
        hints = (say("check_depth_images_pictures_belong"),)
        raise CaptureError("CAPTURE_NO_POSES", reason, file=frames[0].name, hints=hints)
    return metres


def _depth_ratios(alignment: Alignment, number: int, frame: Frame) -> Floats:
    """Return measured over computed depth (K,) of the points that a view sees, where depth is known."""
    try:
        view, depth_m = alignment.views[number], frame.load_depth_m()
    except CaptureError:  # it is passed over, and named, when the frames are fused
        return np.zeros(0)
    xyz = alignment.xyz[alignment.seen_point[alignment.seen_view == number]]
    z = (np.linalg.inv(view.camera_to_world) @ np.column_stack([xyz, np.ones(len(xyz))]).T)[2]
    scale = np.array(depth_m.shape[::-1]) / np.array(view.photo.size)
    column, row = np.rint((project(view, xyz) + 0.5) * scale - 0.5).astype(np.int64).T
    inside = (column >= 0) & (column < depth_m.shape[1]) & (row >= 0) & (row < depth_m.shape[0]) & (z > 0)
    measured = depth_m[row[inside], column[inside]].astype(np.float64)
    return np.asarray((measured / z[inside])[measured > 0])
