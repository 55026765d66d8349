"""The pictures that a capture's points bring along for textures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.edge.cameras.nouns import PhotoView
from capture2vr.edge.capture.nouns import Capture, Frame, Intrinsics, Photo
from capture2vr.edge.capture_to_points import to_points
from capture2vr.edge.fusion.texture_views import MAX_TEXTURE_VIEWS, select_texture_views
from capture2vr.edge.photos.depth_maps import TEXTURE_PX, PhotoColours, at_texture_resolution

CAMERA = Intrinsics(60.0, 60.0, 31.5, 23.5, 64, 48)


def frame(number: int, *, pictured: bool = True) -> Frame:
    """A wall at 1 m, seen from a way along it; its picture tells its number."""
    pose = np.eye(4)
    pose[0, 3] = 0.01 * number
    rgb = np.full((96, 128, 3), number % 256, np.uint8)
    depth = np.ones((48, 64), np.float32)
    return Frame(f"{number}", CAMERA, pose, lambda: depth, None, (lambda: rgb) if pictured else None)


@given(st.lists(st.floats(0, 1e6), min_size=1, max_size=300))
def test_they_are_few_sharp_and_from_all_along_the_way(sharpness: list[float]) -> None:
    shots = select_texture_views([frame(number) for number in range(len(sharpness))], np.array(sharpness))
    taken = [round(100 * shot.camera_to_world[0, 3]) for shot in shots]
    assert len(taken) == min(len(sharpness), MAX_TEXTURE_VIEWS)
    assert taken == sorted(set(taken))
    apart = np.diff([-1, *taken, len(sharpness)])
    assert apart.max() <= 2 * -(-len(sharpness) // len(taken))
    assert sharpness[taken[int(np.argmax([sharpness[each] for each in taken]))]] == max(sharpness)


def test_frames_without_a_picture_are_passed_over() -> None:
    frames = [frame(number, pictured=number == 2) for number in range(4)]
    (shot,) = select_texture_views(frames, np.zeros(4))
    assert shot.load_rgb().shape == (96, 128, 3)
    assert (shot.load_rgb() == 2).all()
    assert select_texture_views([frame(0, pictured=False)], np.zeros(1)) == ()


def test_a_photo_is_loaded_larger_for_a_texture_than_for_its_depth() -> None:
    asked: list[int | None] = []

    def load(longest: int | None = None) -> np.ndarray:
        asked.append(longest)
        return np.zeros((2, 3, 3), np.uint8)

    photo = Photo("a.jpg", (64, 48), "phone", load, turns=1)
    view = PhotoView(photo, CAMERA, (0.0,) * 5, np.eye(4))  # type: ignore[arg-type]
    assert at_texture_resolution(PhotoColours(view, 640))().shape == (3, 2, 3)  # upright
    assert asked == [TEXTURE_PX]
    sensor = frame(0).load_rgb
    assert sensor is not None
    assert at_texture_resolution(sensor) is sensor


def test_points_of_a_capture_bring_them_along() -> None:
    frames = tuple(frame(number) for number in range(3))
    points = to_points(Capture("rgbd", "test", frames=frames), cut="scene")
    assert [shot.load_rgb()[0, 0, 0] for shot in points.texture_views] == [0, 1, 2]
    assert points.texture_views[1].camera_to_world == pytest.approx(frames[1].camera_to_world)
    assert points.texture_views[1].load_depth_m().shape == (48, 64)
    assert points.texture_views[1].intrinsics == CAMERA
    bare = to_points(
        Capture("rgbd", "test", frames=tuple(replace(each, load_rgb=None) for each in frames)), cut="scene"
    )
    assert bare.texture_views == ()
