"""Around one thing or around in a room, and how large: what photos alone do not tell, and what tells it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.nouns import Capture, Frame, Intrinsics
from capture2vr.edge.capture_to_points import to_points
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.fusion.orbit import meeting_point, require_aim, sees_a_scene, sure_aim
from capture2vr.edge.points.nouns import Points
from capture2vr.edge.points.scale import scale_to_longest, span
from tests.support.scenes import PHONE, Scene, film, furnished_room, look_around, look_at, plane, scene

LENS = Intrinsics(500, 500, 320, 240, 640, 480)


def frames(eyes: Floats, targets: Floats) -> list[Frame]:
    """Cameras at eyes (N,3) that look at targets (N,3)."""
    poses = np.tile(np.eye(4), (len(eyes), 1, 1))
    poses[:, :3, 3] = eyes
    z = targets - eyes
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    x = np.cross([0.0, 1, 0.1], z)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    poses[:, :3, :3] = np.stack([x, np.cross(z, x), z], axis=2)
    return [
        Frame(str(number), LENS, pose, lambda: np.zeros((480, 640)), window_px=5) for number, pose in enumerate(poses)
    ]


def ring(count: int, degrees: float = 360) -> Floats:
    angle = np.radians(np.linspace(0, degrees, count))
    return np.stack([np.cos(angle), np.full(count, 0.4), np.sin(angle)], axis=1)


@given(st.integers(3, 40), st.floats(30, 360), st.integers(0, 99))
def test_a_walk_around_a_thing_aims_at_it_roughly(count: int, degrees: float, seed: int) -> None:
    aims = np.random.default_rng(seed).normal(0, 0.04, (count, 3))
    assert not sees_a_scene(frames(ring(count, degrees), aims))


def test_a_short_walk_does_not_tell_how_far_away_its_aim_is() -> None:
    aims = np.random.default_rng(0).normal(0, 0.04, (9, 3))
    assert sure_aim(frames(ring(9, 30), aims)) is None


@given(st.integers(3, 40), st.floats(120, 360), st.floats(-1, 1))
def test_what_is_cut_out_must_be_what_the_photos_aim_at(count: int, degrees: float, side: float) -> None:
    eyes = ring(count, degrees)
    aim = sure_aim(frames(eyes, np.zeros((count, 3))))
    assert aim is not None
    thing = np.random.default_rng(0).normal(0, 0.05, (200, 3))
    require_aim(thing + 0.1 * side, aim, eyes)
    with pytest.raises(CaptureError, match="what you aimed at gave no depth") as found:
        require_aim(thing + np.array([0, -0.4, 1.0 + side / 2]), aim, eyes)
    assert found.value.hints


@given(st.integers(10, 40), st.integers(0, 99))
def test_from_the_middle_of_a_room_outward_is_no_thing(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    eyes = rng.normal(0, 0.2, (count, 3))
    assert "outward" in sees_a_scene(frames(eyes, 3 * ring(count)))


def test_along_a_wall_is_no_thing() -> None:
    eyes = np.stack([np.linspace(0, 3, 12), np.zeros(12), np.zeros(12)], axis=1)
    assert "along a wall" in sees_a_scene(frames(eyes, eyes + np.array([0, 0, 1.0])))


def test_some_photos_of_something_else_change_nothing() -> None:
    eyes = ring(20)
    targets = np.zeros((20, 3))
    targets[::10] = [5, 5, 5]
    found = frames(eyes, targets)
    axes = np.stack([frame.camera_to_world[:3, 2] for frame in found])
    assert np.linalg.norm(meeting_point(eyes, axes)) < 1e-3
    assert not sees_a_scene(found)


def filmed(world: Scene, poses: Floats) -> Capture:
    """Photos of a rendered scene with their depth, as stereo would have it."""
    frames = film(world, poses, PHONE)
    return Capture("rgbd", "test", frames=tuple(replace(frame, window_px=2) for frame in frames))


def inward(count: int) -> Floats:
    """Cameras on a walk along the walls of the furnished room, which look across it over the furniture."""
    turns = np.linspace(0, 2 * np.pi, count, endpoint=False)
    middle = np.array([2.2, 1.9, 1.9])
    eyes = middle + np.stack([1.6 * np.cos(turns), 1.3 * np.sin(turns), np.zeros(count)], axis=1)
    return np.stack([look_at(eye, middle) for eye in eyes])


def along_the_wall(count: int) -> Floats:
    eyes = np.stack([np.linspace(0.8, 4.2, count), np.full(count, 2.4), np.full(count, 1.4)], axis=1)
    return np.stack([look_at(eye, eye - [0, 1, 0]) for eye in eyes])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("poses", "why"), [(look_around(12), "outward"), (along_the_wall(8), "along a wall"), (inward(12), "across a room")]
)
def test_a_rendered_room_is_not_cut(poses: Floats, why: str) -> None:
    points = to_points(filmed(furnished_room(), poses), voxel=0.03)
    assert points.cut is not None
    assert (points.cut.kept, points.uncut) == ("scene", None)
    assert why in points.cut.because
    assert np.ptp(points.xyz, axis=0).max() > 3


@pytest.mark.slow
@pytest.mark.parametrize("arc", [0.8, 2.0], ids=["a half circle", "all around"])
def test_a_thing_on_a_table_before_a_wall_is_cut(arc: float) -> None:
    wall = trimesh.creation.box((3.0, 0.02, 2.0))
    wall.apply_translation([0, 1.2, 0.5])
    ball = trimesh.creation.icosphere(4, 0.15)
    ball.apply_translation([0, 0, 0.15])
    world = scene((plane(1.2, 1.2), (150, 120, 90)), (ball, (200, 40, 40)), (wall, (200, 200, 190)))
    turns = np.pi * (1.5 + np.linspace(-arc / 2, arc / 2, 12, endpoint=arc < 2))
    poses = np.stack([look_at((np.cos(turn), np.sin(turn), 0.7), (0, 0, 0.12)) for turn in turns])
    points = to_points(filmed(world, poses))
    assert points.cut is not None
    assert points.cut.kept == "object"
    assert np.abs(np.linalg.norm(points.xyz - [0, 0, 0.15], axis=1) - 0.15).max() < 0.02, "nothing but the ball"


def test_a_sensor_is_pointed_at_what_is_wanted() -> None:
    sensed = [replace(frame, window_px=1) for frame in frames(ring(20), np.zeros((20, 3)))]
    assert "sensor" in sees_a_scene(sensed)


@given(st.integers(2, 200), st.integers(1, 3), st.integers(0, 99))
def test_the_span_is_the_farthest_pair_in_space_plane_and_line(count: int, dimensions: int, seed: int) -> None:
    xyz = np.zeros((count, 3))
    xyz[:, :dimensions] = np.random.default_rng(seed).random((count, dimensions))
    truth = np.linalg.norm(xyz[:, None] - xyz[None], axis=2).max()
    assert span(xyz) == pytest.approx(truth)


@pytest.mark.slow
def test_the_span_of_a_round_cloud_whose_points_are_all_corners() -> None:
    xyz = np.random.default_rng(0).normal(size=(20_000, 3))
    assert span(xyz / np.linalg.norm(xyz, axis=1, keepdims=True)) == pytest.approx(2, rel=2e-3)


def test_one_length_sets_the_scale() -> None:
    xyz = np.random.default_rng(0).random((500, 3))
    told = scale_to_longest(Points(xyz, None, np.ones(500), 1.0, "unknown", None), 0.31)
    assert span(told.xyz) * told.metres_per_unit == pytest.approx(0.31)
    assert told.scale_confidence == "estimated"
