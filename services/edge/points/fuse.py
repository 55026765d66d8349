"""Posed depth images -> one set of coloured points.

1. survey  a few frames tell the range of depths to believe and the size of a pixel on the surface
2. gather  every frame is cleaned, back-projected and averaged into a voxel grid of that size
3. examine the views vote: what agrees is averaged along the rays, what stands in seen-through space goes
4. merge   the moved points are averaged into the grid once more
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from services.edge.arrays import Bools, Bytes, Floats, Tick, no_tick
from services.edge.capture.nouns import Frame
from services.edge.points.depth import DepthView, read_view
from services.edge.points.grid import Samples, VoxelGrid, voxel_keys
from services.edge.points.survey import MIN_PIXELS, survey_frames, too_few
from services.edge.points.views import Verdict, cross_examine
from services.edge.srgb import to_linear, to_srgb

MAX_POINTS = 1_500_000
"""Voxels kept at most; the voxel grows beyond. About 100 MB of sums."""
_VOTING_VIEWS = 48
"""Views kept in memory to vote: 48 of 256x192 are 50 MB, and more of a walk around a thing add little."""
_VOXEL_PIXELS = 1.2
"""Voxel over the size of a depth pixel on the surface: just above 1, a surface seen once leaves no holes."""
_WINDOWED_VOXEL_PIXELS = 2.0
"""The same of depth that windows were compared for, whose pixels tell less each."""
_FRONTAL = 2
"""Power of the cosine by which a picture's light counts beyond the depth's weight: a slanted pixel mixes colours."""
_SHARP = 2
"""Power of the sharpness: with half of the pictures blurred colours are 4 levels off, at 1 they were 6, at 0 14."""
_LEAST_SHARPNESS = 1.0
"""Grey levels squared: what rounding leaves on a picture of one colour."""
_SURROUNDINGS = 4.0
"""Cell, in voxels, in which points compare how many views agree on them."""
_OUTVOTED = 5
"""Fewer than a fifth of the views that agree next to it."""
_AIM = 0.2
"""The middle of the image, as a share of its sides, that tells what the person aimed at."""


@dataclass(frozen=True, slots=True)
class Fused:
    """Fused points in the capture frame (metres).

    xyz (N,3) float64; rgb (N,3) uint8 or None; confidence (N,) float32; voxel: size used, metres;
    cameras (M,3) positions; sharpness (M,) of the pictures, 0 without one; aim (3,): what the cameras had in the middle
    of their images, or None.
    """

    xyz: Floats
    rgb: Bytes | None
    confidence: Floats
    voxel: float
    cameras: Floats
    sharpness: Floats
    aim: Floats | None
    warnings: tuple[str, ...]


def fuse(frames: Sequence[Frame], *, voxel: float | None = None, tick: Tick = no_tick) -> Fused:
    """Fuse posed depth frames into points, `voxel` metres apart (from the pixels' size when None).

    One frame is in memory at a time, besides the grid and at most `_VOTING_VIEWS` depth images. Raises CaptureError:
    CAPTURE_TOO_FEW_POINTS where hardly any depth is usable.
    """
    survey = survey_frames(frames)
    origin = np.asarray(frames[0].camera_to_world, np.float64)[:3, 3]
    pixels = _WINDOWED_VOXEL_PIXELS if windowed(frames) else _VOXEL_PIXELS
    grid = VoxelGrid(voxel or survey.pixel_m * pixels, MAX_POINTS)
    voters = set(np.linspace(0, len(frames) - 1, min(len(frames), _VOTING_VIEWS)).round().astype(int).tolist())
    views: list[DepthView] = []
    aims: list[Floats] = []
    sharpness = np.zeros(len(frames))
    read = kept = 0
    for number, frame in enumerate(frames):
        view = read_view(frame, survey.limits)
        samples, sharpness[number] = _observe(view, frame, origin)
        grid.add(samples)
        aims += _aim(view)
        read, kept = read + view.read, kept + len(samples)
        if number in voters:
            views.append(view)
        tick(0.7 * (number + 1) / len(frames))
    if kept < MIN_PIXELS:
        raise too_few(len(frames), read, kept, survey.limits)
    merged = _agreed(grid, views, origin, lambda fraction: tick(0.7 + 0.3 * fraction))
    rgb = to_srgb(_fill_light(merged)) if merged.clarity.any() else None
    cameras = np.stack([np.asarray(frame.camera_to_world, np.float64)[:3, 3] for frame in frames])
    aim = np.median(np.stack(aims), axis=0) if aims else None
    xyz = merged.xyz.astype(np.float64) + origin
    return Fused(xyz, rgb, np.clip(merged.confidence, 0, 1), grid.voxel, cameras, sharpness, aim, survey.warnings)


def windowed(frames: Sequence[Frame]) -> bool:
    """Whether the depth is that of stereo, not of a sensor."""
    return any(frame.window_px > 1 for frame in frames)


def _observe(view: DepthView, frame: Frame, origin: Floats) -> tuple[Samples, float]:
    """Back-project the believed pixels; weight = cosine · confidence / z² (depth noise grows with z). And how sharp
    the picture is."""
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
    if frame.load_rgb is not None:
        rgb = at_resolution(frame.load_rgb(), view.inverse_depth.shape)
        light = to_linear(rgb[rows, columns])
        sharpness = _sharpness(rgb)
        clarity = sharpness**_SHARP * view.cosine[rows, columns] ** _FRONTAL
    return Samples(xyz, normal, light, clarity, confidence, weight), sharpness


def _sharpness(rgb: Bytes) -> float:
    """The variance of the picture's Laplacian, in grey levels squared: motion and bad focus bring it down by tens.

    Only pictures of one surface compare, and those are what a voxel averages.
    """
    import cv2

    grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    return max(float(cv2.Laplacian(grey, cv2.CV_32F).var()), _LEAST_SHARPNESS)


def at_resolution(rgb: Bytes, shape: tuple[int, ...]) -> Bytes:
    """The picture (h,w,3) at the depth's (H,W): a depth pixel's colour is the mean of what it covers."""
    import cv2

    if rgb.shape[:2] == shape:
        return rgb
    shrink = rgb.shape[0] > shape[0]
    method = cv2.INTER_AREA if shrink else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(rgb, (shape[1], shape[0]), interpolation=method), np.uint8)


def _agreed(grid: VoxelGrid, views: list[DepthView], origin: Floats, tick: Tick) -> Samples:
    """Points moved to where the views agree and averaged again, those in free space dropped.

    The confidence is the sensor's times n/(n+1), n being the number of views that agree: 1/2 for what one view saw.
    """
    samples = grid.averages()
    if len(views) < 2:
        return replace(samples, confidence=samples.confidence / 2)
    verdict = cross_examine(samples.xyz, samples.normal, views, origin, tick)
    agree = np.maximum(verdict.agree, 1)
    moved = replace(samples, xyz=verdict.xyz, confidence=samples.confidence * agree / (agree + 1))
    merged = VoxelGrid(grid.voxel, MAX_POINTS)
    merged.add(moved.take(~(_contradicted(verdict) | _outvoted(verdict, grid.voxel))))
    return merged.averages()


def _contradicted(verdict: Verdict) -> Bools:
    """Two views at least, and more than half as many as agree, saw free space where the point is."""
    contradicted: Bools = (verdict.contradict >= 2) & (verdict.contradict * 2 > verdict.agree)
    return contradicted


def _outvoted(verdict: Verdict, voxel: float) -> Bools:
    """Far fewer views agree on the point than on its surroundings: a layer of noise behind the surface, where no view
    sees free space."""
    _, cell = np.unique(voxel_keys(verdict.xyz, _SURROUNDINGS * voxel), return_inverse=True)
    most = np.zeros(cell.max(initial=0) + 1, verdict.agree.dtype)
    np.maximum.at(most, cell, verdict.agree)
    outvoted: Bools = verdict.agree * _OUTVOTED < most[cell]
    return outvoted


def _fill_light(samples: Samples) -> Floats:
    """The light of points that no picture saw comes from the nearest point that one did."""
    from scipy.spatial import cKDTree

    seen = samples.clarity > 0
    if seen.all():
        return samples.light
    light = samples.light.copy()
    _, nearest = cKDTree(samples.xyz[seen]).query(samples.xyz[~seen], workers=-1)
    light[~seen] = samples.light[seen][nearest]
    return light


def _aim(view: DepthView) -> list[Floats]:
    """The surface in the middle of the image, capture frame, as a list of one or none."""
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
