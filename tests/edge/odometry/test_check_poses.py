"""Given poses that contradict their frames are found, and true ones never are, however a phone's sensor spoils them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture2vr.edge.arrays import Floats
from capture2vr.edge.cameras.place_frames import place_frames
from capture2vr.edge.capture.images import broken_image
from capture2vr.edge.capture.nouns import Capture, Frame
from capture2vr.edge.capture_to_points import to_points
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.odometry.check_poses import pose_fault
from capture2vr.edge.odometry.posed_frames import _without_strays, with_poses
from capture2vr.edge.procrustes import procrustes
from tests.edge.odometry.test_tracker import off_m, things
from tests.support.photos.walkaround import film_walkaround
from tests.support.scenes import Sensor, film, furnished_room, look_around, orbit, table_with_sphere

PHONE_NOISE = Sensor(noise_m=0.003, flying=0.3)


@cache
def things_filmed() -> tuple[Frame, ...]:
    return film(things(), orbit(30, radius=0.8, height=0.6), sensor=PHONE_NOISE)


@cache
def room_filmed() -> tuple[Frame, ...]:
    return film(furnished_room(), look_around(36), sensor=PHONE_NOISE)


FLIP = np.diag([1.0, -1.0, -1.0, 1.0])


def poses(frames: tuple[Frame, ...]) -> Floats:
    return np.stack([np.asarray(frame.camera_to_world) for frame in frames])


def posed(frames: tuple[Frame, ...], given_poses: Floats) -> tuple[Frame, ...]:
    return tuple(replace(frame, camera_to_world=pose) for frame, pose in zip(frames, given_poses, strict=True))


def shuffled(true: Floats) -> Floats:
    return true[np.random.default_rng(0).permutation(len(true))]


def all_the_same(true: Floats) -> Floats:
    return np.repeat(true[:1], len(true), axis=0)


def in_opengl_axes(true: Floats) -> Floats:
    return true @ FLIP


@pytest.mark.slow
@pytest.mark.parametrize("filmed", [things_filmed, room_filmed], ids=["things", "room"])
@pytest.mark.parametrize("spoil", [shuffled, np.linalg.inv, all_the_same, in_opengl_axes])
def test_wrong_poses_are_found(filmed: Callable[[], tuple[Frame, ...]], spoil: Callable[[Floats], Floats]) -> None:
    frames = filmed()
    fault = pose_fault(posed(frames, spoil(poses(frames))))
    assert fault is not None
    assert ("all" in fault and "the same" in fault) == (spoil is all_the_same)


@pytest.mark.slow
@settings(max_examples=10)
@given(st.floats(0, 0.006), st.floats(0, 0.01), st.floats(0, 1.0), st.integers(0, 100))
def test_true_poses_pass_with_a_phones_noise_and_drift(noise: float, shift: float, turn: float, seed: int) -> None:
    sensor = Sensor(noise_m=noise, jitter_m=shift, jitter_deg=turn, flying=0.3)
    for world, way in ((things(), orbit(12, radius=0.8, height=0.6)), (furnished_room(), look_around(12))):
        assert pose_fault(film(world, way, sensor=sensor, seed=seed)) is None


def test_a_camera_that_stands_still_passes() -> None:
    still = orbit(1, radius=0.8, height=0.6).repeat(12, axis=0)
    assert pose_fault(film(things(), still, sensor=PHONE_NOISE)) is None
    assert pose_fault(things_filmed()[:1]) is None


def test_frames_that_share_no_view_tell_nothing() -> None:
    apart = poses(things_filmed())
    apart[:, :3, 3] += 1.5 * np.arange(len(apart))[:, None]
    assert pose_fault(posed(things_filmed(), apart)) is None


def test_poses_in_millimetres_are_found() -> None:
    far = poses(things_filmed())
    far[:, :3, 3] *= 1000
    fault = pose_fault(posed(things_filmed(), far))
    assert fault is not None
    assert "times as far apart" in fault


@pytest.mark.parametrize("number", [0, 5])
def test_one_pose_far_away_does_not_make_a_landscape_of_things(number: int) -> None:
    frames = things_filmed()[:12]
    far = poses(frames)
    far[number, 0, 3] += 130.0
    points = to_points(Capture("rgbd", "open3d", frames=posed(frames, far), scale_confidence="metric"), cut="scene")
    assert np.ptp(points.xyz, axis=0).max() < 2
    (warning,) = points.warnings
    assert warning.startswith(f"frame skipped: {number:04}: has a camera pose that is 1")


def test_a_walk_far_away_is_no_wrong_pose() -> None:
    far = np.concatenate([poses(things_filmed())] * 12)
    far[-30:, 0, 3] += np.linspace(0, 60, 30)
    capture = Capture("rgbd", "open3d", frames=posed(things_filmed() * 12, far), scale_confidence="metric")
    assert _without_strays(capture) is capture


@pytest.mark.slow
@pytest.mark.parametrize("spoil", [shuffled, all_the_same])
def test_instead_of_wrong_poses_the_way_is_tracked(spoil: Callable[[Floats], Floats]) -> None:
    frames = things_filmed()[:12]
    up = np.array([0.0, 0.0, 1.0])
    capture = Capture("rgbd", "open3d", frames=posed(frames, spoil(poses(frames))), scale_confidence="metric", up=up)
    found = with_poses(capture)
    assert off_m(found.frames, poses(frames)).max() < 0.01
    assert found.up is None  # it was told in the world of the poses that were not used
    assert "poses" in found.warnings[0]
    assert "computed from the images" in found.warnings[0]


@pytest.mark.slow
def test_wrong_poses_of_frames_that_cannot_be_tracked_are_an_error() -> None:
    frames = film(table_with_sphere(), orbit(8, radius=0.8, height=0.6), sensor=PHONE_NOISE)
    far = poses(frames) * [[[1, 1, 1, 1000]] * 3 + [[1, 1, 1, 1]]]
    capture = Capture("rgbd", "open3d", frames=posed(frames, far), scale_confidence="metric")
    with pytest.raises(CaptureError) as caught:
        to_points(capture)
    assert caught.value.code == "CAPTURE_BAD_POSE"
    assert "camera-to-world" in caught.value.hints[0]


@pytest.fixture(scope="module")
def walk() -> tuple[Frame, ...]:
    return film_walkaround(14, 140.0)


@pytest.mark.slow
def test_frames_that_cannot_be_tracked_are_placed_by_their_pictures_in_metres(walk: tuple[Frame, ...]) -> None:
    """Every frame shows another side than the three before it: no depth is ever aligned."""
    stills = [walk[number] for start in range(4) for number in range(start, len(walk), 4)]
    stills = [frame for pair in zip(stills[:7], stills[7:], strict=True) for frame in pair]
    bare = tuple(replace(frame, camera_to_world=None, load_depth_m=partial_depth(frame)) for frame in stills)
    found = with_poses(Capture("rgbd", "open3d", frames=bare, scale_confidence="metric"))
    truth = {frame.name: np.asarray(frame.camera_to_world)[:3, 3] for frame in walk}
    eyes = poses(found.frames)[:, :3, 3]
    true_eyes = np.stack([truth[frame.name] for frame in found.frames])
    rigid = procrustes(eyes, true_eyes, scale=False)
    assert len(found.frames) >= 12
    assert rigid is not None
    assert np.linalg.norm(eyes @ rigid[:3, :3].T + rigid[:3, 3] - true_eyes, axis=1).max() < 0.01
    assert "could not be tracked by depth" in found.warnings[0]


@pytest.mark.slow
def test_damaged_frames_do_not_keep_the_others_from_being_placed(walk: tuple[Frame, ...]) -> None:
    def damaged() -> Floats:
        raise broken_image("0003.png", "cannot be decoded: its image data are damaged")

    spoilt = list(walk)
    spoilt[3], spoilt[6] = replace(walk[3], load_rgb=damaged), replace(walk[6], load_depth_m=damaged)
    placed, warnings = place_frames(spoilt)
    assert [frame.name for frame in placed] == [frame.name for frame in walk if frame is not walk[3]]
    assert warnings == ("frame skipped: 0003.png: cannot be decoded: its image data are damaged",)


def partial_depth(frame: Frame) -> Callable[[], Floats]:
    """Depth at every fifth pixel of every fifth row, as a sensor of few dots measures it: nothing to align."""

    def load() -> Floats:
        depth_m, dots = frame.load_depth_m(), np.zeros((360, 480), bool)
        dots[::5, ::5] = True
        return np.where(dots, depth_m, 0)

    return load


@pytest.mark.slow
def test_depth_of_something_else_gives_no_scale(walk: tuple[Frame, ...]) -> None:
    other = [replace(frame, load_depth_m=film_noise(number)) for number, frame in enumerate(walk)]
    with pytest.raises(CaptureError) as caught:
        place_frames(other)
    assert caught.value.code == "CAPTURE_NO_POSES"
    assert "something else" in caught.value.message


def film_noise(seed: int) -> Callable[[], Floats]:
    return lambda: np.random.default_rng(seed).uniform(0.2, 4, (360, 480)).astype(np.float32)
