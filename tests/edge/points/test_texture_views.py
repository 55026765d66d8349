"""Pictures that are held out: few, from all along the way, and used for nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.edge.capture.nouns import Capture, Frame, Intrinsics
from capture2vr.edge.capture_to_points import to_points
from capture2vr.edge.fusion.texture_views import HOLD_OUT_FROM, MAX_TEXTURE_VIEWS, hold_out_frames, select_scene_views

CAMERA = Intrinsics(60.0, 60.0, 31.5, 23.5, 64, 48)


def frame(number: int, *, pictured: bool = True) -> Frame:
    """A wall at 1 m, seen from a way along it."""
    pose = np.eye(4)
    pose[0, 3] = 0.01 * number
    depth, rgb = np.ones((48, 64), np.float32), np.zeros((48, 64, 3), np.uint8)
    return Frame(f"{number}", CAMERA, pose, lambda: depth, None, (lambda: rgb) if pictured else None)


def numbers(frames: tuple[Frame, ...]) -> list[int]:
    return [int(each.name) for each in frames]


@given(st.lists(st.booleans(), max_size=60), st.none() | st.integers(0, 60))
def test_every_frame_is_either_held_out_or_not(pictured: list[bool], count: int | None) -> None:
    frames = [frame(number, pictured=each) for number, each in enumerate(pictured)]
    kept, held_out = hold_out_frames(frames, count)
    assert sorted([*numbers(kept), *numbers(held_out)]) == list(range(len(frames)))
    assert numbers(kept) == sorted(numbers(kept))
    assert numbers(held_out) == sorted(numbers(held_out))
    assert all(each.load_rgb is not None for each in held_out)


@given(st.integers(0, 100))
def test_one_in_eight_is_held_out_at_most_four_and_none_of_a_few(pictures: int) -> None:
    frames = [frame(number) for number in range(pictures)]
    _, held_out = hold_out_frames([*frames, frame(pictures, pictured=False)])
    assert len(held_out) == (0 if pictures < HOLD_OUT_FROM else min(pictures // 8, 4))


@given(st.integers(1, 100), st.data())
def test_as_many_as_asked_are_held_out_evenly(pictures: int, data: st.DataObject) -> None:
    count = data.draw(st.integers(1, pictures))
    _, held_out = hold_out_frames([frame(number) for number in range(pictures)], count)
    assert len(held_out) == count
    apart = pictures / count
    middles = (np.arange(count) + 0.5) * apart  # of equal parts of the way
    assert np.abs(np.array(numbers(held_out)) + 0.5 - middles).max() <= 0.5 + 1e-9
    assert (np.diff(numbers(held_out)) >= np.floor(apart)).all()


@pytest.mark.parametrize(("pictures", "asked", "held_out"), [(20, None, 2), (15, None, 0), (15, 2, 2), (20, 0, 0)])
def test_neither_points_nor_textures_are_made_from_them(pictures: int, asked: int | None, held_out: int) -> None:
    frames = [frame(number) for number in range(pictures)]
    white = {each.name for each in hold_out_frames(frames, asked)[1]}
    coloured = tuple(
        replace(each, load_rgb=lambda shade=255 * (each.name in white): np.full((48, 64, 3), shade, np.uint8))
        for each in frames
    )
    points = to_points(Capture("rgbd", "test", frames=coloured), cut="scene", hold_out=asked)
    compared = [each.name for each in points.held_out_views]
    used = [each.name for each in points.texture_views]
    assert set(compared) == white
    assert len(compared) == held_out
    assert sorted([*compared, *used], key=int) == [each.name for each in frames]
    assert points.rgb is not None
    assert points.rgb.max() == 0, "all other pictures are black"


def test_scenes_get_the_sharpest_picture_of_each_few_steps() -> None:
    """Frames a centimetre apart, 25 of which are one place; one of each 30 is sharpest"""
    walk = [frame(number, pictured=number != 40) for number in range(100)]
    sharpness = np.array([2.0 if number % 30 == 7 else 1.0 for number in range(100)])
    chosen = [int(view.name) for view in select_scene_views(walk, sharpness)]
    assert chosen == [7, 37, 67, 97]


def test_a_scene_of_any_length_has_its_pictures() -> None:
    walk = [frame(26 * number) for number in range(200)]
    assert len(select_scene_views(walk, np.ones(200))) == 200 > MAX_TEXTURE_VIEWS
