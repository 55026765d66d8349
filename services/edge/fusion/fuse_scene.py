"""Fuse the depth images of a scene, however large: at once while its voxels fit in memory, else box by box.

1. survey  every frame is read once: a few of its pixels tell what part of space it sees     (scene_walk.py), and
           from how near, so that what others saw from much nearer is left out              (viewing_distance.py)
2. cut     space is cut into boxes of some million voxels each                                (scene_boxes.py)
3. fuse    each box with a rim around it, as `fuse` does it, from the frames that show it; those that look through it
           vote, and outliers are removed
4. write   the points of each box, without its rim, to disk                                   (fused_files.py)

Neighbouring boxes have the same voxels, so the points are those of fusing at once, but for the views that vote: 48 of
each box instead of 48 of the whole. Memory is that of one box and its views; a frame is read once for each box that it
shows, three to five times.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import partial

import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats, Tick, no_tick, part_of
from capture2vr.edge.capture.nouns import Frame
from capture2vr.edge.fusion.depth_consensus import VotingView
from capture2vr.edge.fusion.depth_range import survey_frames
from capture2vr.edge.fusion.fuse import (
    MAX_POINTS,
    VOTING_VIEWS,
    FusedPoints,
    fill_light,
    fuse,
    merge_agreeing,
    voxel_pixels,
)
from capture2vr.edge.fusion.fused_files import FusedFiles
from capture2vr.edge.fusion.observe import observe
from capture2vr.edge.fusion.scene_boxes import SceneBox, within
from capture2vr.edge.fusion.scene_walk import SceneWalk, survey_walk
from capture2vr.edge.parallel import one_ahead
from capture2vr.edge.points.depth_limits import DepthLimits, DepthView
from capture2vr.edge.points.frame_faults import FrameFaults
from capture2vr.edge.points.outliers import inliers
from capture2vr.edge.points.voxel_grid import GridFullError, Samples, VoxelGrid
from capture2vr.edge.srgb import to_srgb

SCENE_VOXEL_M = 0.005
"""Least voxel of a scene that does not fit in memory, metres: tiles have cells of 1 cm, and average what is in one."""
BOX_POINTS = 5_000_000
"""Most voxels of a box: 2 GB at 640 x 480, with the views that vote. Smaller boxes have each frame read more often."""
SOME_POINTS = 1_000_000
"""Most points that stay in memory, of those on disk: as many as of a large cloud."""
_RIM_VOXELS = 16
"""Rim around a box, in voxels: what moves into the box when views agree, and the neighbours of its points."""
_SURVEY_SHARE = 0.1  # of the time
_TRY_SHARE = 0.9  # of a box's time; the rest is for its halves, where it turns out to be too large


def fuse_scene(
    frames: Sequence[Frame],
    *,
    voxel: float | None = None,
    most: int = MAX_POINTS,
    most_of_box: int = BOX_POINTS,
    tick: Tick = no_tick,
) -> FusedPoints:
    """Fuse posed depth frames into points, as `fuse` does, or box by box where there are more voxels than `most` even
    of SCENE_VOXEL_M: then the result holds some of the points, and all of them in `whole`.

    most_of_box  voxels of a box, before the views vote
    Raises CaptureError as `fuse`.
    """
    reached = [0.0]

    def note(fraction: float) -> None:
        reached.append(fraction)
        tick(fraction)

    with suppress(GridFullError):  # which must be gone before more is read: its traceback holds the grid and the views
        return fuse(frames, voxel=voxel, most=most, coarsest=SCENE_VOXEL_M, tick=note)
    return _fuse_by_boxes(frames, voxel, most_of_box, part_of(tick, reached[-1], 1))


def _fuse_by_boxes(frames: Sequence[Frame], voxel: float | None, most: int, tick: Tick) -> FusedPoints:
    survey, faults = survey_frames(frames), FrameFaults()
    voxel = voxel or max(survey.pixel_m * voxel_pixels(frames), SCENE_VOXEL_M)
    walk = survey_walk(frames, survey.limits, faults, part_of(tick, 0, _SURVEY_SHARE))
    files = FusedFiles(walk.origin)
    boxes = list(SceneBox.around(walk.places, voxel).split(most))
    for number, box in enumerate(boxes):
        begin, end = (_SURVEY_SHARE + (1 - _SURVEY_SHARE) * (number + part) / len(boxes) for part in (0, 1))
        for samples in _fuse_box(walk, box, voxel, survey.limits, most, part_of(tick, begin, end)):
            files.append(samples.xyz, _colours(samples), np.clip(samples.confidence, 0, 1))
    xyz, rgb, confidence = files.sample(SOME_POINTS)
    return FusedPoints(
        xyz,
        rgb,
        confidence,
        voxel,
        walk.frames,
        walk.eyes.astype(np.float64) + walk.origin,
        walk.sharpness,
        None,
        survey.warnings + faults.warnings(len(frames)),
        files.whole(),
    )


def _fuse_box(
    walk: SceneWalk, box: SceneBox, voxel: float, limits: DepthLimits, most: int, tick: Tick
) -> Iterator[Samples]:
    """Fuse a box, or its halves where it has more voxels than `most`."""
    samples = None
    with suppress(GridFullError):
        grid = VoxelGrid(voxel, most, np.inf if box.is_smallest else voxel)
        samples = _fuse_whole_box(walk, box, grid, limits, part_of(tick, 0, _TRY_SHARE))
    if samples is not None:
        yield samples
        return
    for number, half in enumerate(box.halves()):
        begin, end = (_TRY_SHARE + (1 - _TRY_SHARE) * (number + part) / 2 for part in (0, 1))
        yield from _fuse_box(walk, half, voxel, limits, most, part_of(tick, begin, end))


def _fuse_whole_box(walk: SceneWalk, box: SceneBox, grid: VoxelGrid, limits: DepthLimits, tick: Tick) -> Samples:
    low, high = box.bounds_m(grid.voxel)
    rim = _RIM_VOXELS * grid.voxel
    shown = set(walk.frames_that_show(low - rim, high + rim).tolist())
    asked = set(walk.frames_that_look_through(*box.occupied_m(grid.voxel), VOTING_VIEWS).tolist())
    views, chosen = [], sorted(shown | asked)
    read = partial(_read, walk, limits, FrameFaults(), low - rim, high + rim)
    for number, found in enumerate(one_ahead(read, chosen)):
        if found is not None:
            view, samples = found
            if chosen[number] in shown:
                grid.add(samples)
            if chosen[number] in asked:
                views.append(VotingView.of(view))
        tick(0.7 * (number + 1) / len(chosen))
    merged = merge_agreeing(grid, views, walk.origin, part_of(tick, 0.7, 0.85))
    merged = merged.take(inliers(merged.xyz.astype(np.float64), part_of(tick, 0.85, 1)))
    return merged.take(within(merged.xyz, low, high))


def _read(
    walk: SceneWalk, limits: DepthLimits, faults: FrameFaults, low: Floats, high: Floats, number: int
) -> tuple[DepthView, Samples] | None:
    """Read a frame of the walk; None where it cannot be decoded any more."""
    frame = walk.frames[number]
    view = faults.read_view(frame, limits)
    if view is None:
        return None
    eye = walk.eyes[number]

    def is_wanted(xyz: Floats) -> Bools:
        wanted = within(xyz, low, high)
        wanted[wanted] = walk.distance.is_near(xyz[wanted], eye)
        return wanted

    samples, _ = observe(view, faults.read_picture(frame), walk.origin, is_wanted)
    return view, samples


def _colours(samples: Samples) -> Bytes | None:
    """sRGB (N,3) of samples; None where no picture shows any of them."""
    return to_srgb(fill_light(samples)) if samples.clarity.any() else None
