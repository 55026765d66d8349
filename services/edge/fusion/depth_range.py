"""Survey a few depth frames: the range of valid depths, and the size of a pixel on the surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import evenly
from capture2vr.edge.capture.nouns import Frame
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.points.depth_limits import DepthLimits, load_depth
from capture2vr.sentences.sentence import say

MIN_PIXELS = 100
"""Least number of usable depth pixels in a whole capture; fewer do not describe a surface."""
_NEAR_M, _FAR_M = 0.1, 8.0
"""Range, in metres, that phone depth sensors are specified for."""
_NEAR_STEREO, _FAR_STEREO = 1 / 8, 10.0
"""The same of photos, over the median depth: their unit may be any. Of photos at arm's length these are no narrower."""
_MIN_CONFIDENCE = 0.25
"""Least confidence of a valid pixel: it drops the lowest of the usual three levels (0, 1/2, 1)."""
_SURVEY_FRAMES = 8
"""Most frames that are surveyed."""
_NEARER_HALF = 35
"""Percentile of the pixel sizes that sets the voxel size: the object is nearer than its surroundings."""


@dataclass(frozen=True, slots=True)
class Survey:
    """Result of the survey.

    limits: of valid depth and confidence; pixel_m: size of a depth pixel on the nearer surfaces, metres;
    warnings: sentences for the report.
    """

    limits: DepthLimits
    pixel_m: float
    warnings: tuple[str, ...]


def survey_frames(frames: Sequence[Frame]) -> Survey:
    """Survey up to `_SURVEY_FRAMES` frames; those that cannot be decoded are passed over.

    Raises CaptureError: CAPTURE_TOO_FEW_POINTS when they have no depth, or why not one of them can be decoded.
    """
    chosen = evenly(frames, _SURVEY_FRAMES)
    depths, confidences, pixels = [], [], []
    broken: list[CaptureError] = []
    for frame in chosen:
        try:
            depth_m, confidence, camera = load_depth(frame)
        except CaptureError as error:
            broken.append(error)
            continue
        z = depth_m[depth_m > 0]
        depths.append(z)
        confidences.append(confidence[depth_m > 0])
        pixels.append(z / max(camera.fx, camera.fy))
    if not depths:
        raise broken[0]
    z, confidence, pixel = np.concatenate(depths), np.concatenate(confidences), np.concatenate(pixels)
    if z.size < MIN_PIXELS:
        raise too_few_pixels(len(chosen), z.size, 0, DepthLimits(_NEAR_M, _FAR_M, _MIN_CONFIDENCE))
    middle = float(np.median(z))
    near_m = _NEAR_M if middle > 2 * _NEAR_M else middle / 2
    far_m = _FAR_M if middle < _FAR_M / 2 else 2 * middle
    if any(frame.window_px > 1 for frame in frames):
        near_m, far_m = min(near_m, _NEAR_STEREO * middle), max(far_m, _FAR_STEREO * middle)
    usual = (z >= near_m) & (z <= far_m)
    warnings: tuple[str, ...] = ()
    trusted = float(np.mean(confidence[usual] >= _MIN_CONFIDENCE))
    if trusted < 0.05:
        warnings = (say("only_depth_pixels_marked", trusted=trusted),)
    limits = DepthLimits(near_m, far_m, _MIN_CONFIDENCE if trusted >= 0.05 else 0.0)
    return Survey(limits, float(np.percentile(pixel[usual], _NEARER_HALF)), warnings)


def too_few_pixels(frames: int, read: int, usable: int, limits: DepthLimits) -> CaptureError:
    """Return the error for `frames` depth images with `read` pixels of depth, of which `usable` passed the filters."""
    return CaptureError(
        "CAPTURE_TOO_FEW_POINTS",
        say(
            "depth_pixels_in_frames",
            read=read,
            frames=frames,
            usable=usable,
            near=limits.near_m,
            far=limits.far_m,
            least=MIN_PIXELS,
        ),
        hints=(
            say("hold_phone_0_3"),
            say("glass_mirrors_black_shiny_surfaces"),
            say("check_depth_images_in_metres"),
        ),
    )
