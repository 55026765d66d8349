"""Fuse posed depth images into one coloured point cloud.

1. survey   a few frames give the range of valid depths and the size of a pixel on the surface
2. gather   every frame is filtered, back-projected and averaged into a voxel grid of that size
3. examine  the views vote: points that agree are averaged along the rays, points in free space are dropped
4. merge    the moved points are averaged into a voxel grid once more
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from services.edge.arrays import Bools, Bytes, Floats, Tick, no_tick
from services.edge.capture.nouns import Frame
from services.edge.parallel import one_ahead
from services.edge.points.depth_consensus import ViewAgreement, vote_on_points
from services.edge.points.depth_limits import DepthView
from services.edge.points.depth_range import MIN_PIXELS, survey_frames, too_few_pixels
from services.edge.points.frame_faults import FrameFaults
from services.edge.points.voxel_grid import Samples, VoxelGrid, voxel_keys
from services.edge.srgb import to_linear, to_srgb

MAX_POINTS = 3_000_000
"""Most voxels: with more, the voxel size grows. About 200 MB of sums. Of 100 photos around a thing on the ground the
surroundings fill 1.5 million, and with the coarser voxels the thing's median error was .088 % instead of .053."""
_VOTING_VIEWS = 48
"""Views kept in memory for the vote: 48 of 256x192 are 50 MB; more of a walk around an object add little."""
_VOXEL_PIXELS = 1.2
"""Voxel size over the size of a depth pixel on the surface: just above 1, so that one view leaves no holes."""
_STEREO_VOXEL_PIXELS = 2.0
"""The same for stereo depth, which is matched by windows, so that neighbouring pixels are not independent."""
_FRONTAL = 2
"""Power of the cosine in a colour's weight, on top of the depth's weight: a slanted pixel mixes colours."""
_SHARP = 2
"""Power of the sharpness in a colour's weight: with half of the pictures blurred, colours are 4 levels off; with a
power of 1 it was 6, with 0 14."""
_LEAST_SHARPNESS = 1.0
"""Grey levels squared: the sharpness that rounding leaves in a picture of one colour."""
_SURROUNDINGS = 4.0
"""Side, in voxels, of the cells in which the points' numbers of agreeing views are compared."""
_OUTVOTED = 5
"""A point is dropped if fewer than a fifth as many views agree on it as on the best point of its surroundings."""
_AIM = 0.2
"""Central part of the image, as a share of its sides, that the person aimed at."""


@dataclass(frozen=True, slots=True)
class FusedPoints:
    """Result of the fusion: points in the capture frame (metres).

    xyz (N,3) float64; rgb (N,3) uint8 or None; confidence (N,) float32; voxel: size used, metres;
    frames: the M that could be decoded, without `load_rgb` where only the picture could not; cameras (M,3) positions;
    sharpness (M,) of the pictures, 0 without one; aim (3,): median of the surface points in the middle of the images,
    or None.
    """

    xyz: Floats
    rgb: Bytes | None
    confidence: Floats
    voxel: float
    frames: tuple[Frame, ...]
    cameras: Floats
    sharpness: Floats
    aim: Floats | None
    warnings: tuple[str, ...]


def fuse(frames: Sequence[Frame], *, voxel: float | None = None, tick: Tick = no_tick) -> FusedPoints:
    """Fuse posed depth frames into points, `voxel` metres apart (None: derived from the pixels' size).

    Two frames are in memory at a time, besides the grid and at most `_VOTING_VIEWS` depth images. Raises CaptureError:
    CAPTURE_TOO_FEW_POINTS where hardly any depth is usable, or the first one's error where more than MAX_BAD_SHARE of
    the depth images cannot be decoded.
    """
    survey = survey_frames(frames)
    origin = np.asarray(frames[0].camera_to_world, np.float64)[:3, 3]
    pixels = _STEREO_VOXEL_PIXELS if has_stereo_depth(frames) else _VOXEL_PIXELS
    grid = VoxelGrid(voxel or survey.pixel_m * pixels, MAX_POINTS)
    voters = set(np.linspace(0, len(frames) - 1, min(len(frames), _VOTING_VIEWS)).round().astype(int).tolist())
    views: list[DepthView] = []
    aims: list[Floats] = []
    used: list[Frame] = []
    sharpness: list[float] = []
    faults = FrameFaults()
    read = usable = 0

    def read_frame(frame: Frame) -> tuple[DepthView, Frame, Samples, float] | None:
        view = faults.read_view(frame, survey.limits)
        if view is None:
            return None
        rgb = faults.read_picture(frame)
        return view, frame if rgb is not None else replace(frame, load_rgb=None), *_observe(view, rgb, origin)

    for number, found in enumerate(one_ahead(read_frame, frames)):
        if found is None:
            continue
        view, frame, samples, sharp = found
        used.append(frame)
        sharpness.append(sharp)
        grid.add(samples)
        aims += _aim_point(view)
        read, usable = read + view.read, usable + len(samples)
        if number in voters:
            views.append(view)
        tick(0.7 * (number + 1) / len(frames))
    faults.check(len(frames))
    if usable < MIN_PIXELS:
        raise too_few_pixels(len(frames), read, usable, survey.limits)
    merged = _merge_agreeing(grid, views, origin, lambda fraction: tick(0.7 + 0.3 * fraction))
    rgb = to_srgb(_fill_light(merged)) if merged.clarity.any() else None
    cameras = np.stack([np.asarray(frame.camera_to_world, np.float64)[:3, 3] for frame in used])
    aim = np.median(np.stack(aims), axis=0) if aims else None
    xyz = merged.xyz.astype(np.float64) + origin
    return FusedPoints(
        xyz,
        rgb,
        np.clip(merged.confidence, 0, 1),
        grid.voxel,
        tuple(used),
        cameras,
        np.array(sharpness),
        aim,
        survey.warnings + faults.warnings(len(frames)),
    )


def has_stereo_depth(frames: Sequence[Frame]) -> bool:
    """Return whether the depth was computed by stereo matching, not measured by a sensor."""
    return any(frame.window_px > 1 for frame in frames)


def _observe(view: DepthView, rgb: Bytes | None, origin: Floats) -> tuple[Samples, float]:
    """Back-project the valid pixels of a view; return the samples and the picture's sharpness.

    weight = cosine · confidence / z²: depth noise grows with z."""
    rows, columns = np.nonzero(view.inverse_depth)
    inverse, confidence = view.inverse_depth[rows, columns], view.confidence[rows, columns]
    camera = view.intrinsics
    x, y = (columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy
    local = np.stack([x, y, np.ones_like(x)], axis=1, dtype=np.float32) / inverse[:, None]
    rotation = view.camera_to_world[:3, :3].astype(np.float32)
    xyz = local @ rotation.T + (view.camera_to_world[:3, 3] - origin).astype(np.float32)
    normal = view.normal[rows, columns] @ rotation.T
    weight = view.cosine[rows, columns] * inverse * inverse * np.maximum(confidence, 0.05)
    light: Floats = np.zeros((len(xyz), 3), np.float32)
    clarity: Floats = np.zeros(len(xyz), np.float32)
    sharpness = 0.0
    if rgb is not None:
        rgb = at_resolution(rgb, view.inverse_depth.shape)
        light = to_linear(rgb[rows, columns])
        sharpness = _sharpness(rgb)
        clarity = sharpness**_SHARP * view.cosine[rows, columns] ** _FRONTAL
    return Samples(xyz, normal, light, clarity, confidence, weight), sharpness


def _sharpness(rgb: Bytes) -> float:
    """Return the variance of the picture's Laplacian, in grey levels squared: blur lowers it by a factor of tens.

    It is comparable only between pictures of the same surface, such as a voxel averages.
    """
    import cv2

    grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    return max(float(cv2.Laplacian(grey, cv2.CV_32F).var()), _LEAST_SHARPNESS)


def at_resolution(rgb: Bytes, shape: tuple[int, ...]) -> Bytes:
    """Resize a picture (h,w,3) to the depth's (H,W); a depth pixel gets the mean colour of the area that it covers."""
    import cv2

    if rgb.shape[:2] == shape:
        return rgb
    shrink = rgb.shape[0] > shape[0]
    method = cv2.INTER_AREA if shrink else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(rgb, (shape[1], shape[0]), interpolation=method), np.uint8)


def _merge_agreeing(grid: VoxelGrid, views: list[DepthView], origin: Floats, tick: Tick) -> Samples:
    """Move points to where the views agree, drop those in free space, and average the rest into a new grid.

    The confidence is the sensor's times n/(n+1), n being the number of views that agree: 1/2 for a single view.
    """
    samples = grid.averages()
    if len(views) < 2:
        return replace(samples, confidence=samples.confidence / 2)
    verdict = vote_on_points(samples.xyz, samples.normal, views, origin, tick)
    agree = np.maximum(verdict.agree, 1)
    moved = replace(samples, xyz=verdict.xyz, confidence=samples.confidence * agree / (agree + 1))
    merged = VoxelGrid(grid.voxel, MAX_POINTS)
    merged.add(moved.take(~(_contradicted_mask(verdict) | _outvoted_mask(verdict, grid.voxel))))
    return merged.averages()


def _contradicted_mask(verdict: ViewAgreement) -> Bools:
    """Return a mask (N,): True where at least two views, and more than half as many as agree, see free space; and where
    one view does on a point that one view alone believes."""
    outvoted = (verdict.contradict >= 2) & (verdict.contradict * 2 > verdict.agree)
    alone: Bools = (verdict.contradict >= 1) & (verdict.agree <= 1)
    return outvoted | alone


def _outvoted_mask(verdict: ViewAgreement, voxel: float) -> Bools:
    """Return a mask (N,): True where far fewer views agree on a point than on its surroundings.

    This finds layers of noise behind a surface, where no view sees free space."""
    _, cell = np.unique(voxel_keys(verdict.xyz, _SURROUNDINGS * voxel), return_inverse=True)
    most = np.zeros(cell.max(initial=0) + 1, verdict.agree.dtype)
    np.maximum.at(most, cell, verdict.agree)
    outvoted: Bools = verdict.agree * _OUTVOTED < most[cell]
    return outvoted


def _fill_light(samples: Samples) -> Floats:
    """Return the light (N,3), filling points without a colour from the nearest point that has one."""
    from scipy.spatial import cKDTree

    seen = samples.clarity > 0
    if seen.all():
        return samples.light
    light = samples.light.copy()
    _, nearest = cKDTree(samples.xyz[seen]).query(samples.xyz[~seen], workers=-1)
    light[~seen] = samples.light[seen][nearest]
    return light


def _aim_point(view: DepthView) -> list[Floats]:
    """Return the surface point in the middle of the image, capture frame, as a list of one; empty without depth."""
    height, width = view.inverse_depth.shape
    rows = slice(int(height * (1 - _AIM) / 2), int(height * (1 + _AIM) / 2) + 1)
    columns = slice(int(width * (1 - _AIM) / 2), int(width * (1 + _AIM) / 2) + 1)
    inverse = view.inverse_depth[rows, columns]
    if not inverse.any():
        return []
    z = 1 / float(np.median(inverse[inverse > 0]))
    camera = view.intrinsics
    local = np.array([((width - 1) / 2 - camera.cx) / camera.fx, ((height - 1) / 2 - camera.cy) / camera.fy, 1.0]) * z
    return [view.camera_to_world[:3, :3] @ local + view.camera_to_world[:3, 3]]
