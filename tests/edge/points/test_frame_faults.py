"""Frames whose images are damaged behind whole headers: the others are used, and the warning names them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.images import broken_image
from capture2vr.edge.capture.nouns import Capture, Frame
from capture2vr.edge.capture_to_points import to_points
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.odometry.tracker import track_frames
from tests.edge.odometry.test_tracker import things
from tests.support.scenes import film, orbit


@cache
def frames_of_things() -> tuple[Frame, ...]:
    return film(things(), orbit(20, radius=0.8, height=0.6, turn=0.3))


def damaged(name: str) -> Floats:
    raise broken_image(name, "cannot be decoded: its image data are damaged")


def with_damage(*numbers: int, depth: bool) -> tuple[Frame, ...]:
    def spoil(frame: Frame) -> Frame:
        if depth:
            return replace(frame, load_depth_m=lambda: damaged(frame.name))
        return replace(frame, load_rgb=lambda: damaged(frame.name))

    return tuple(spoil(frame) if number in numbers else frame for number, frame in enumerate(frames_of_things()))


def capture_of(frames: tuple[Frame, ...]) -> Capture:
    return Capture("rgbd", "open3d", frames=frames, scale_confidence="metric")


@pytest.mark.slow
def test_a_damaged_picture_costs_its_colours_only() -> None:
    points = to_points(capture_of(with_damage(7, depth=False)), cut="scene")
    assert len(points) == pytest.approx(len(to_points(capture_of(frames_of_things()), cut="scene")), rel=0.01)
    assert [warning for warning in points.warnings if "0007" in warning] == list(points.warnings)
    assert points.warnings[0].startswith("colours skipped: 0007")
    assert "0007" not in {view.name for view in (*points.texture_views, *points.held_out_views)}


@pytest.mark.slow
@pytest.mark.parametrize("depth", [False, True])
def test_a_damaged_frame_among_those_held_out_is_not_compared_with(depth: bool) -> None:
    held_out = {view.name for view in to_points(capture_of(frames_of_things()), cut="scene").held_out_views}
    first = min(map(int, held_out))
    points = to_points(capture_of(with_damage(first, depth=depth)), cut="scene")
    assert {view.name for view in points.held_out_views} == held_out - {f"{first:04}"}
    what = "frame" if depth else "colours"
    assert points.warnings == (f"{what} skipped: {first:04}: cannot be decoded: its image data are damaged",)


@pytest.mark.slow
def test_a_damaged_depth_image_costs_its_frame() -> None:
    points = to_points(capture_of(with_damage(0, depth=True)), cut="scene")
    assert points.warnings == ("frame skipped: 0000: cannot be decoded: its image data are damaged",)


def test_more_than_a_tenth_of_them_is_the_first_ones_error() -> None:
    with pytest.raises(CaptureError) as caught:
        to_points(capture_of(with_damage(3, 5, 7, depth=True)), cut="scene")
    assert (caught.value.code, caught.value.file) == ("IMAGE_UNREADABLE", "0003")


def test_when_none_can_be_decoded_the_error_says_why() -> None:
    with pytest.raises(CaptureError, match="damaged"):
        to_points(capture_of(with_damage(*range(20), depth=True)), cut="scene")


@pytest.mark.slow
def test_empty_depth_images_are_counted_and_named() -> None:
    none = np.zeros((192, 256), np.float32)
    frames = tuple(replace(frame, load_depth_m=lambda: none) if number in (0, 4) else frame
                   for number, frame in enumerate(frames_of_things()))  # fmt: skip
    (warning,) = to_points(capture_of(frames), cut="scene", hold_out=0).warnings
    assert warning.startswith("2 of 20 depth images are empty and were not used: 0000, 0004.")


@pytest.mark.slow
def test_the_tracker_passes_over_damaged_frames_and_says_so() -> None:
    bare = tuple(replace(frame, camera_to_world=None) for frame in with_damage(3, depth=True))
    tracked = track_frames(bare)
    assert len(tracked.frames) == 19
    assert any("frame skipped: 0003" in warning for warning in tracked.warnings)
