"""Check the camera poses of depth frames against their images: do cameras see what their neighbours saw?

Points of one frame are projected into another. Where that one measured a surface behind a point, it saw through it; a
surface in front of it may hide it. Shares of the points that one of the two holds for, medians over pairs of
neighbouring frames:

                                              seen alike   correlation of the brightness
    true poses, a phone's noise                  0.99         0.94 to 1
    poses jittered by 2 cm and 2 degrees         0.89         0.64
    poses of other frames                        0.43 to 0.67 0.05 to 0.14
    world-to-camera taken for camera-to-world    0.46 to 0.60 0 to 0.8
    OpenGL's axes taken for OpenCV's             0.69 to 0.88 0
    all poses equal, the frames not              0.57 to 0.83 0.02 to 0.65
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Floats, Ints
from capture2vr.edge.capture.nouns import Frame, Intrinsics
from capture2vr.edge.fusion.observe import at_resolution
from capture2vr.edge.points.frame_faults import FrameFaults
from capture2vr.sentences.sentence import say

_MOST_FRAMES = 24
_STEPS = (-2, -1, 1, 2)  # from a frame to those that it is compared with, among the chosen ones
_MOST_POINTS = 2_000  # of a frame: a pair's share is then exact to 1 %
_LEAST_POINTS = 100  # that a pair shares; fewer say nothing
_ALIKE = 0.1  # relative difference of depth: ten times a phone's noise, five times what drift does to neighbours
_NEAREST_M, _FARTHEST_M = 0.1, 8.0  # that phones measure; beyond, a difference of a tenth says nothing
_FLAT_GREY = 3.0  # grey levels, 1 sigma: brightness that varies less is noise
_SEEN_ALIKE = 0.78  # least share of the points that are not seen through
_SEEN_ALIKE_DIM = 0.9  # the same where the pictures' brightness does not correlate either
_CORRELATED = 0.35
_SEEN_ALIKE_STILL = 0.97  # the same where the poses say that the camera stood still
_LONGEST_JUMP = 5.0  # median step from frame to frame over the median depth; poses in millimetres have 50 and more
_STILL_M, _STILL = 1e-3, 2e-3  # metres, and elements of the rotation (0.1 degrees): equal poses


@dataclass(frozen=True, slots=True)
class _Glimpse:
    """A frame's depth (H,W) m, its grey picture (H,W) or None, and some of its pixels: (K,) rows and columns, and where
    they are in the world (K,3)."""

    camera: Intrinsics
    world_to_camera: Floats
    depth_m: Floats
    grey: Floats | None
    rows: Ints
    columns: Ints
    xyz: Floats


def pose_fault(frames: Sequence[Frame]) -> str | None:
    """Return a clause that says how the poses contradict the frames' images, or None where they do not.

    frames, each with its pose. Frames that share no view with their neighbours tell nothing, and pass.
    """
    numbers = np.unique(np.linspace(0, len(frames) - 1, min(_MOST_FRAMES, len(frames))).round().astype(int))
    glimpses = [found for number in numbers.tolist() if (found := _glimpse(frames[number])) is not None]
    if (jump := _jump(frames, glimpses)) > _LONGEST_JUMP:
        return say("from_frame_to_frame_camera", times=jump)
    pairs = _compare_neighbours(glimpses)
    if not pairs:
        return None
    seen_alike = float(np.median([share for share, _ in pairs]))
    if _stands_still(frames):
        same = say("all_camera_poses_same", count=len(frames))
        return same if seen_alike < _SEEN_ALIKE_STILL else None
    if seen_alike > (_SEEN_ALIKE if _is_correlated(pairs) else _SEEN_ALIKE_DIM):
        return None
    return say("camera_poses_contradict_depth_images", share=1 - seen_alike)


def _compare_neighbours(glimpses: Sequence[_Glimpse]) -> list[tuple[float, float]]:
    """Compare each frame with its neighbours: what `_compare` says of the pairs that share enough."""
    neighbours = [(first, first + step) for first in range(len(glimpses)) for step in _STEPS]
    inside = [(first, second) for first, second in neighbours if 0 <= second < len(glimpses)]
    return [pair for first, second in inside if (pair := _compare(glimpses[first], glimpses[second]))]


def _is_correlated(pairs: Sequence[tuple[float, float]]) -> bool:
    """Return whether the brightness of neighbours correlates; True where none of them tells."""
    known = [correlation for _, correlation in pairs if np.isfinite(correlation)]
    return not known or float(np.median(known)) > _CORRELATED


def _jump(frames: Sequence[Frame], glimpses: Sequence[_Glimpse]) -> float:
    """Return the median distance between a frame's pose and the next one's, over the median depth; 0 if unknown."""
    if len(frames) < 2 or not glimpses:
        return 0.0
    eyes = np.stack([np.asarray(frame.camera_to_world, np.float64)[:3, 3] for frame in frames])
    depth_m = np.median([np.median(each.depth_m[each.rows, each.columns]) for each in glimpses])
    return float(np.median(np.linalg.norm(np.diff(eyes, axis=0), axis=1)) / depth_m)


def _stands_still(frames: Sequence[Frame]) -> bool:
    """Return whether all poses of two frames or more are equal."""
    poses = np.stack([np.asarray(frame.camera_to_world, np.float64) for frame in frames])
    spread = np.ptp(poses, axis=0)
    return len(frames) > 1 and bool(spread[:3, 3].max() < _STILL_M and spread[:3, :3].max() < _STILL)


def _glimpse(frame: Frame) -> _Glimpse | None:
    """Sample a frame; None where it has hardly any depth, or cannot be decoded."""
    import cv2

    faults = FrameFaults()
    loaded = faults.read_depth(frame)
    if loaded is None:
        return None
    depth_m, _, camera = loaded
    rows, columns = np.nonzero((depth_m > _NEAREST_M) & (depth_m < _FARTHEST_M))
    if len(rows) < _LEAST_POINTS:
        return None
    some = np.random.default_rng(0).permutation(len(rows))[:_MOST_POINTS]
    rows, columns = rows[some], columns[some]
    z, pose = depth_m[rows, columns], np.asarray(frame.camera_to_world, np.float64)
    local = np.stack([(columns - camera.cx) / camera.fx * z, (rows - camera.cy) / camera.fy * z, z], axis=1)
    rgb = faults.read_picture(frame)
    grey = None if rgb is None else cv2.cvtColor(at_resolution(rgb, depth_m.shape), cv2.COLOR_RGB2GRAY)
    world_to_camera = np.linalg.inv(pose)
    xyz = local @ pose[:3, :3].T + pose[:3, 3]
    return _Glimpse(
        camera, world_to_camera, depth_m, None if grey is None else np.asarray(grey, np.float32), rows, columns, xyz
    )


def _compare(first: _Glimpse, second: _Glimpse) -> tuple[float, float] | None:
    """Return the share of the first's points that the second sees alike, of those that it sees alike or through, and
    the correlation of their brightness (NaN: unknown); None where they share too little."""
    x, y, z = (first.xyz @ second.world_to_camera[:3, :3].T + second.world_to_camera[:3, 3]).T
    ahead = np.flatnonzero(z > _NEAREST_M)
    column = np.rint(x[ahead] / z[ahead] * second.camera.fx + second.camera.cx).astype(np.int64)
    row = np.rint(y[ahead] / z[ahead] * second.camera.fy + second.camera.cy).astype(np.int64)
    height, width = second.depth_m.shape
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    at, row, column = ahead[inside], row[inside], column[inside]
    measured = second.depth_m[row, column]
    known = measured > 0
    if known.sum() < _LEAST_POINTS:
        return None
    at, row, column, behind = at[known], row[known], column[known], measured[known] / z[at[known]] - 1
    alike = np.abs(behind) < _ALIKE
    through = behind > _ALIKE
    if not (alike | through).any():  # something hides them all
        return None
    share = float(alike.sum() / (alike | through).sum())
    return share, _correlation(first, second, at[alike], row[alike], column[alike])


def _correlation(first: _Glimpse, second: _Glimpse, at: Ints, row: Ints, column: Ints) -> float:
    """Return the correlation of the brightness of the first's points `at` and the second's pixels; NaN: unknown."""
    if first.grey is None or second.grey is None or len(at) < _LEAST_POINTS:
        return float("nan")
    here, there = first.grey[first.rows[at], first.columns[at]], second.grey[row, column]
    if min(here.std(), there.std()) < _FLAT_GREY:
        return float("nan")
    return float(np.corrcoef(here, there)[0, 1])
