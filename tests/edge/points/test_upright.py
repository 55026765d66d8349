"""Which way is up: rendered walks whose up is known, each with the source that should tell it, and its error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.edge.arrays import Floats
from capture2vr.edge.asset.manifest import rotation_between
from capture2vr.edge.capture.nouns import Capture, Intrinsics, UpSource
from capture2vr.edge.capture_to_points import to_points
from capture2vr.edge.points.upright import SURE, find_up, from_cameras, from_walk
from capture2vr.edge.points.vertical_lines import vertical_lines
from tests.support.scenes import (
    KINECT,
    PHONE,
    Scene,
    film,
    furnished_room,
    look_around,
    look_at,
    orbit,
    plane,
    scene,
    table_with_sphere,
)

UP = np.array([0.0, 0.0, 1.0])
TURN = trimesh.transformations.rotation_matrix(2.1, [1, -2, 0.5])
"""Of the world, so that no axis of the capture is up."""


@dataclass(frozen=True)
class Walk:
    """A walk before a scene: its poses, what should tell its up, and the error that this may have."""

    world: Callable[[], Scene]
    poses: Floats
    teller: str
    error_deg: float
    camera: Intrinsics = PHONE


def by_hand(poses: Floats) -> Floats:
    """The poses of somebody whose hand sways by 2 cm, and rolls by 4 degrees."""
    rng = np.random.default_rng(0)
    held = poses.copy()
    for pose in held:
        pose[:3, :3] @= trimesh.transformations.rotation_matrix(rng.normal(0, np.radians(4)), [0, 0, 1])[:3, :3]
        pose[:3, 3] += rng.normal(0, 0.02, 3)
    return held


def capture(walk: Walk) -> Capture:
    frames = film(walk.world(), by_hand(walk.poses), walk.camera)
    turned = [replace(each, camera_to_world=TURN @ np.asarray(each.camera_to_world), window_px=2) for each in frames]
    return Capture("rgbd", "test", frames=tuple(turned))


def off_deg(up: Floats | None) -> float:
    assert up is not None
    return float(np.degrees(np.arccos(np.clip(up @ TURN[:3, :3] @ UP, -1, 1))))


def box(size: tuple[float, float, float], at: tuple[float, float, float]) -> trimesh.Trimesh:
    made = trimesh.creation.box(size)
    made.apply_translation(at)
    return made


def relief() -> Scene:
    """A fox's head, of sorts, at a wall: it sticks out 20 cm; no floor is in sight."""
    head = trimesh.creation.icosphere(4, 0.15)
    head.apply_scale([1, 1.3, 0.9])
    head.apply_translation([0, 0.05, 1.4])
    return scene((box((3, 0.02, 2.4), (0, 0.1, 1.4)), (210, 205, 190)), (head, (190, 90, 40)))


def sloping_desk() -> Scene:
    """A ball on a desk that slopes by 8 degrees."""
    slope = trimesh.transformations.rotation_matrix(np.radians(8), [1, 0, 0])
    desk, ball = plane(1.2, 1.2), trimesh.creation.icosphere(4, 0.15)
    ball.apply_translation([0, 0, 0.15])
    for part in (desk, ball):
        part.apply_transform(slope)
    return scene((desk, (150, 120, 90)), (ball, (200, 40, 40)))


def leaning_box() -> Scene:
    """A tall box on a level table, which leans by 10 degrees: its edges are the only lines that nearly stand."""
    tower = box((0.15, 0.15, 0.5), (0, 0, 0.25))
    tower.apply_transform(trimesh.transformations.rotation_matrix(np.radians(10), [1, 0.3, 0]))
    return scene((plane(1.2, 1.2), (150, 120, 90)), (tower, (220, 210, 60)))


def half_circle(target: tuple[float, float, float], radius: float, height: float) -> Floats:
    turns = np.pi * (1 + np.linspace(0.1, 0.9, 14))
    eyes = [(radius * np.cos(turn), radius * np.sin(turn), height) for turn in turns]
    return np.stack([look_at(eye, target) for eye in eyes])


def before_the_wall() -> Floats:
    """A hand that goes left and right, up and down before a wall, and hardly turns."""
    eyes = [(x, -1.2, z) for z in (1.2, 1.4, 1.6) for x in np.linspace(-0.15, 0.15, 5)]
    return np.stack([look_at(eye, (0.9 * eye[0], 0, 1.4)) for eye in eyes])


def over_the_thing() -> Floats:
    """A turn about a horizontal axis: from low before the thing to high over it."""
    turns = np.radians(np.linspace(15, 70, 14))
    return np.stack([look_at((0.05, -0.9 * np.cos(turn), 0.9 * np.sin(turn)), (0, 0, 0.1)) for turn in turns])


def sideways() -> Floats:
    """Steps to the side, looking down at a table by 30 degrees."""
    return np.stack([look_at((x, -0.9, 0.62), (0.8 * x, 0, 0.1)) for x in np.linspace(-0.2, 0.2, 8)])


def wavy() -> Floats:
    """A walk around whose height rises and sinks by half a metre."""
    turns = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    eyes = [(0.9 * np.cos(turn), 0.9 * np.sin(turn), 0.7 + 0.4 * np.sin(5 * turn)) for turn in turns]
    return np.stack([look_at(eye, (0, 0, 0.1)) for eye in eyes])


WALKS = {
    "around a thing, at one height": Walk(table_with_sphere, orbit(16, radius=0.9, height=0.6), "plane", 0.2),
    "around a thing, up and down": Walk(table_with_sphere, wavy(), "plane", 0.5),
    "around a thing on a sloping desk": Walk(sloping_desk, orbit(16, radius=0.9, height=0.6), "walk", 1.5),
    "around a box that leans": Walk(leaning_box, wavy(), "plane", 0.5, KINECT),
    "in a room": Walk(furnished_room, look_around(12), "lines", 1.0, KINECT),
    "over a thing, from low to high": Walk(table_with_sphere, over_the_thing(), "plane", 0.5),
    "past a thing, looking down": Walk(table_with_sphere, sideways(), "plane", 0.5),
    "around a relief on a wall": Walk(relief, half_circle((0, 0.05, 1.4), 1.1, 1.5), "walk", 1.5),
    "before a relief on a wall": Walk(relief, before_the_wall(), "cameras", 3.0),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", WALKS)
def test_up_of_rendered_walks(name: str) -> None:
    walk = WALKS[name]
    points = to_points(capture(walk), voxel=0.01, cut="scene" if "room" in name else "object")
    assert points.up_source is not None
    print(f"{name}: {points.up_source}, {off_deg(points.up):.2f} degrees off")
    assert points.up_source.teller == walk.teller
    assert off_deg(points.up) < walk.error_deg
    if walk.teller == "cameras":
        assert points.up_source.confidence < SURE


@pytest.mark.slow
def test_a_relief_is_taken_off_its_wall_and_stays_upright() -> None:
    walk = WALKS["around a relief on a wall"]
    points = to_points(capture(walk), voxel=0.01)
    assert points.cut is not None
    assert points.cut.kept == "object"
    assert np.ptp(points.xyz @ TURN[:3, :3], axis=0) == pytest.approx([0.3, 0.2, 0.27], abs=0.1), "the wall is 3 m wide"
    assert off_deg(points.up) < 1.5


def test_what_the_capture_knows_comes_first() -> None:
    made = capture(WALKS["around a thing, at one height"])
    told = TURN[:3, :3] @ np.array([0.0, np.sin(0.2), np.cos(0.2)])
    xyz = np.random.default_rng(0).normal(size=(500, 3))
    up, source = find_up(replace(made, up=told, up_source=UpSource("gravity", 0.9)), xyz)
    assert (source.teller, up @ told) == ("gravity", pytest.approx(1))
    _, source = find_up(replace(made, up=told, up_source=UpSource("gravity", 0.3)), xyz)
    assert source.teller == "walk", "what the capture does not know surely does not come first"


@given(st.integers(6, 60), st.floats(90, 360), st.floats(0, 0.02), st.integers(0, 99))
def test_the_plane_of_a_walk_is_as_sure_as_it_says(count: int, degrees: float, sway: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    turns = np.radians(np.linspace(0, degrees, count))
    eyes = np.stack([np.cos(turns), np.sin(turns), rng.normal(0, sway, count)], axis=1)
    found = from_walk(eyes, np.array([0.1, 0, 1.0]) / np.linalg.norm([0.1, 0, 1.0]))
    if found is None or found[1].confidence < SURE:
        return
    assert np.degrees(np.arccos(np.clip(found[0] @ UP, -1, 1))) < 4 * (10 * (1 - found[1].confidence) + 0.2)


@pytest.mark.parametrize(
    "eyes",
    [
        np.outer(np.linspace(0, 1, 9), [1, 0.2, 0]),
        np.stack([np.zeros(9), np.cos(np.linspace(0, 3, 9)), np.sin(np.linspace(0, 3, 9))], axis=1),
    ],
    ids=["a straight way", "a turn over the thing"],
)
def test_some_ways_tell_no_up(eyes: Floats) -> None:
    assert from_walk(eyes, UP) is None


@pytest.mark.slow
def test_lines_that_do_not_stand_tell_nothing() -> None:
    """A room that was rolled by 30 degrees against how the camera was held, and pictures without any lines."""
    walk = WALKS["in a room"]
    frames = film(walk.world(), walk.poses, walk.camera)
    lean = rotation_between(UP, np.array([0, np.sin(0.5), np.cos(0.5)])) @ UP
    found = vertical_lines(frames, lean, 15)
    assert found is None or found[1].confidence < SURE
    noise = np.random.default_rng(0).integers(0, 255, (192, 256, 3), dtype=np.uint8)
    assert vertical_lines([replace(each, load_rgb=lambda: noise) for each in frames], UP, 15) is None
    assert vertical_lines([replace(each, load_rgb=None) for each in frames], UP, 15) is None


def test_cameras_that_hardly_turned_only_guess() -> None:
    assert from_cameras(orbit(12, radius=1, height=0.8))[1].confidence > from_cameras(sideways())[1].confidence
