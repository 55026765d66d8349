"""Scenes that do not fit in memory: fused box by box they give the points of fusing at once, all of them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from capture2vr.edge import capture_to_points
from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.capture.nouns import Capture, Frame
from capture2vr.edge.capture_to_points import to_points
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.fusion.depth_range import survey_frames
from capture2vr.edge.fusion.fuse import FusedPoints, fuse
from capture2vr.edge.fusion.fuse_scene import fuse_scene
from capture2vr.edge.fusion.fused_files import FusedFiles
from capture2vr.edge.fusion.scene_boxes import CELL, SceneBox, within
from capture2vr.edge.fusion.scene_walk import survey_walk
from capture2vr.edge.points.frame_faults import FrameFaults
from capture2vr.edge.points.outliers import inliers
from tests.support.scenes import Sensor, film, furnished_room, look_around

VOXEL = 0.02
MOST, BOX = 20_000, 120_000
"""Voxels of the whole, and of a box: the room has a quarter of a million."""


@cache
def frames() -> tuple[Frame, ...]:
    return film(furnished_room(), look_around(10), sensor=Sensor(noise_m=0.002, jitter_m=0.001))


def fused_by_boxes(of: tuple[Frame, ...]) -> FusedPoints:
    return fuse_scene(of, voxel=VOXEL, most=MOST, most_of_box=BOX)


@cache
def by_boxes() -> FusedPoints:
    return fused_by_boxes(frames())


@cache
def known() -> FusedPoints:
    return fuse(frames(), voxel=VOXEL)


def whole_of(fused: FusedPoints) -> Floats:
    assert fused.whole is not None
    return np.concatenate([part.xyz for part in fused.whole.read()])


def at_once() -> Floats:
    return known().xyz[inliers(known().xyz)]


@pytest.mark.slow
def test_boxes_give_the_points_of_fusing_at_once() -> None:
    boxed, whole = whole_of(by_boxes()), at_once()
    assert len(boxed) == pytest.approx(len(whole), rel=0.01)
    for here, there in ((boxed, whole), (whole, boxed)):
        away, _ = cKDTree(here).query(there)
        assert np.percentile(away, 99) < 0.1 * VOXEL


@pytest.mark.slow
def test_points_are_not_thinned() -> None:
    """What is in memory is some of them; without boxes, the voxels would have grown."""
    fused = by_boxes()
    assert fused.voxel == VOXEL
    assert fused.whole is not None
    assert fused.whole.count > 3 * MOST > 3 * len(fuse(frames(), voxel=VOXEL, most=MOST).xyz)
    spacing, _ = cKDTree(whole_of(fused)).query(whole_of(fused), k=2)
    assert np.median(spacing[:, 1]) < VOXEL


@pytest.mark.slow
def test_colours_are_those_of_fusing_at_once() -> None:
    fused = by_boxes()
    assert fused.whole is not None
    colours = known().rgb
    assert colours is not None
    parts = list(fused.whole.read())
    rgb = np.concatenate([part.rgb for part in parts if part.rgb is not None])
    away, nearest = cKDTree(known().xyz).query(np.concatenate([part.xyz for part in parts]))
    off = np.abs(rgb.astype(float) - colours[nearest]).max(axis=1)
    assert np.percentile(off[away < 0.1 * VOXEL], 99) < 3


@pytest.mark.slow
def test_a_damaged_frame_in_the_middle_loses_only_itself() -> None:
    def fail() -> Floats:
        raise CaptureError("CAPTURE_UNREADABLE", "is cut off", file="0006")

    damaged = (*frames()[:6], replace(frames()[6], load_depth_m=fail), *frames()[7:])
    fused = fused_by_boxes(damaged)
    assert [frame.name for frame in fused.frames] == [frame.name for frame in damaged if frame.name != "0006"]
    assert any("0006" in warning for warning in fused.warnings)
    without = whole_of(fused_by_boxes(frames()[:6] + frames()[7:]))
    assert np.array_equal(whole_of(fused), without)


@pytest.mark.slow
def test_a_picture_that_cannot_be_read_costs_only_its_colours() -> None:
    def fail() -> Bytes:
        raise CaptureError("CAPTURE_UNREADABLE", "is cut off", file="0006.jpg")

    fused = fused_by_boxes((*frames()[:6], replace(frames()[6], load_rgb=fail), *frames()[7:]))
    assert len(fused.frames) == len(frames())
    assert fused.frames[6].load_rgb is None
    assert any("0006.jpg" in warning for warning in fused.warnings)


def test_a_scene_that_fits_is_fused_at_once() -> None:
    fused = fuse_scene(frames()[:2], voxel=VOXEL)
    assert fused.whole is None
    assert np.array_equal(fused.xyz, fuse(frames()[:2], voxel=VOXEL).xyz)


@pytest.mark.slow
def test_a_walk_reaches_the_tiles_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """Through `to_points`, whose limits are lowered to those of a small room."""
    monkeypatch.setattr(capture_to_points, "fuse_scene", partial(fuse_scene, most=MOST, most_of_box=BOX))
    ticks: list[float] = []
    capture = Capture("rgbd", "test", frames=frames(), scale_confidence="metric")
    points = to_points(capture, voxel=VOXEL, cut="scene", tick=ticks.append)
    assert points.whole is not None
    assert points.whole.count == len(points)  # so few stay in memory
    assert len(points.scene_views) == len(frames())
    assert ticks == sorted(ticks)
    assert ticks[-1] == pytest.approx(1.0)


def test_files_go_with_their_last_reader() -> None:
    files = FusedFiles(np.zeros(3))
    folder, whole = Path(files.folder), files.whole()
    files.append(np.eye(3), None, np.ones(3))
    del files
    assert folder.exists()
    assert [part.rgb for part in whole.read()] == [None]
    del whole
    assert not folder.exists()


@given(st.integers(0, 1000), st.integers(1, 400), st.sampled_from([320, 2_000, 30_000]))
def test_every_place_is_in_one_box(seed: int, count: int, most: int) -> None:
    places = np.random.default_rng(seed).normal(0, 0.3, (count, 3))
    boxes = list(SceneBox.around(places, VOXEL).split(most))
    inside = np.stack([within(places, *box.bounds_m(VOXEL)) for box in boxes])
    assert (inside.sum(axis=0) == 1).all()
    assert sum(len(box.cells) for box in boxes) == len(SceneBox.around(places, VOXEL).cells)
    for box in boxes:
        edges = np.concatenate([each[np.isfinite(each)] for each in (box.low, box.high)])
        assert np.array_equal(edges, np.rint(edges)), f"boxes end between cells of {CELL} voxels"


def test_frames_know_what_they_show_and_what_they_look_through() -> None:
    """A frame in the middle of a room looks through the air before the wall that it shows."""
    walk = survey_walk(frames(), survey_frames(frames()).limits, FrameFaults(), lambda fraction: None)
    owners = walk.owners[walk.places[:, 0] > np.quantile(walk.places[:, 0], 0.95)]
    wall = walk.places[walk.places[:, 0] > np.quantile(walk.places[:, 0], 0.95)].mean(axis=0)
    eye = walk.eyes[owners[0]]
    air, side = (eye + wall) / 2, np.full(3, 0.1)
    assert owners[0] in walk.frames_that_show(wall - 0.5, wall + 0.5)
    assert owners[0] not in walk.frames_that_show(air - side, air + side)
    assert owners[0] in walk.frames_that_look_through(air - side, air + side, len(frames()))
    assert len(walk.frames_that_look_through(wall - 3, wall + 3, 4)) == 4
