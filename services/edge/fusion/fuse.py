"""Fuse posed depth images into one coloured point cloud.

1. survey   a few frames give the range of valid depths and the size of a pixel on the surface
2. gather   every frame is filtered, back-projected and averaged into a voxel grid of that size
3. examine  the views vote: points that agree are averaged along the rays, points in free space are dropped
4. merge    the moved points are averaged into a voxel grid once more
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats, Tick, no_tick
from capture2vr.edge.capture.nouns import CloudParts, Frame
from capture2vr.edge.fusion.depth_consensus import ViewAgreement, VotingView, vote_on_points
from capture2vr.edge.fusion.depth_range import MIN_PIXELS, survey_frames, too_few_pixels
from capture2vr.edge.fusion.observe import observe
from capture2vr.edge.parallel import one_ahead
from capture2vr.edge.points.depth_limits import DepthView
from capture2vr.edge.points.frame_faults import FrameFaults
from capture2vr.edge.points.voxel_grid import Samples, VoxelGrid, voxel_keys
from capture2vr.edge.srgb import to_srgb

MAX_POINTS = 3_000_000
"""Most voxels: with more, the voxel size grows. About 200 MB of sums. Of 100 photos around a thing on the ground the
surroundings fill 1.5 million, and with the coarser voxels the thing's median error was .088 % instead of .053."""
VOTING_VIEWS = 48
"""Views kept in memory for the vote: 48 of 256x192 are 50 MB; more of a walk around an object add little."""
_VOXEL_PIXELS = 1.2
"""Voxel size over the size of a depth pixel on the surface: just above 1, so that one view leaves no holes."""
_STEREO_VOXEL_PIXELS = 2.0
"""The same for stereo depth, which is matched by windows, so that neighbouring pixels are not independent."""
SURROUNDINGS = 4.0
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
    or None; whole: all points where these are only some of them, without outliers.
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
    whole: CloudParts | None = None


def fuse(
    frames: Sequence[Frame],
    *,
    voxel: float | None = None,
    most: int = MAX_POINTS,
    coarsest: float = math.inf,
    tick: Tick = no_tick,
) -> FusedPoints:
    """Fuse posed depth frames into points, `voxel` metres apart (None: derived from the pixels' size).

    most      voxels in memory; with more of them they grow, up to `coarsest` metres: then GridFullError is raised
    Two frames are in memory at a time, besides the grid and at most `VOTING_VIEWS` depth images. Raises CaptureError:
    CAPTURE_TOO_FEW_POINTS where hardly any depth is usable, or the first one's error where more than MAX_BAD_SHARE of
    the depth images cannot be decoded.
    """
    survey = survey_frames(frames)
    origin = np.asarray(frames[0].camera_to_world, np.float64)[:3, 3]
    grid = VoxelGrid(voxel or survey.pixel_m * voxel_pixels(frames), most, coarsest)
    voters = set(np.linspace(0, len(frames) - 1, min(len(frames), VOTING_VIEWS)).round().astype(int).tolist())
    views: list[VotingView] = []
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
        return view, frame if rgb is not None else replace(frame, load_rgb=None), *observe(view, rgb, origin)

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
            views.append(VotingView.of(view))
        tick(0.7 * (number + 1) / len(frames))
    faults.check(len(frames))
    if usable < MIN_PIXELS:
        raise too_few_pixels(len(frames), read, usable, survey.limits)
    merged = merge_agreeing(grid, views, origin, lambda fraction: tick(0.7 + 0.3 * fraction))
    rgb = to_srgb(fill_light(merged)) if merged.clarity.any() else None
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


def voxel_pixels(frames: Sequence[Frame]) -> float:
    """Voxel size over the size of a depth pixel on the surface."""
    return _STEREO_VOXEL_PIXELS if has_stereo_depth(frames) else _VOXEL_PIXELS


def has_stereo_depth(frames: Sequence[Frame]) -> bool:
    """Return whether the depth was computed by stereo matching, not measured by a sensor."""
    return any(frame.window_px > 1 for frame in frames)


def merge_agreeing(grid: VoxelGrid, views: Sequence[VotingView], origin: Floats, tick: Tick) -> Samples:
    """Move points to where the views agree, drop those in free space, and average the rest into a new grid.

    The confidence is the sensor's times n/(n+1), n being the number of views that agree: 1/2 for a single view.
    """
    samples = grid.averages()
    if len(views) < 2:
        return replace(samples, confidence=samples.confidence / 2)
    verdict = vote_on_points(samples.xyz, samples.normal, views, origin, tick)
    agree = np.maximum(verdict.agree, 1)
    moved = replace(samples, xyz=verdict.xyz, confidence=samples.confidence * agree / (agree + 1))
    merged = VoxelGrid(grid.voxel, max(len(samples), 1))
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
    _, cell = np.unique(voxel_keys(verdict.xyz, SURROUNDINGS * voxel), return_inverse=True)
    most = np.zeros(cell.max(initial=0) + 1, verdict.agree.dtype)
    np.maximum.at(most, cell, verdict.agree)
    outvoted: Bools = verdict.agree * _OUTVOTED < most[cell]
    return outvoted


def fill_light(samples: Samples) -> Floats:
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
