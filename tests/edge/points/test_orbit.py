"""Around one thing or around in a room, and how large: what photos alone do not tell, and what tells it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.edge.arrays import Floats
from services.edge.capture.nouns import Frame, Intrinsics
from services.edge.points.nouns import Points
from services.edge.points.orbit import meeting_point, orbits_one_object
from services.edge.points.scale import scale_to_longest, span

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
    return [Frame(str(number), LENS, pose, lambda: np.zeros((480, 640))) for number, pose in enumerate(poses)]


def ring(count: int, degrees: float = 360) -> Floats:
    angle = np.radians(np.linspace(0, degrees, count))
    return np.stack([np.cos(angle), np.full(count, 0.4), np.sin(angle)], axis=1)


@given(st.integers(3, 40), st.floats(30, 360), st.integers(0, 99))
def test_a_walk_around_a_thing_aims_at_it_roughly(count: int, degrees: float, seed: int) -> None:
    aims = np.random.default_rng(seed).normal(0, 0.04, (count, 3))
    assert orbits_one_object(frames(ring(count, degrees), aims))


@given(st.integers(10, 40), st.integers(0, 99))
def test_from_the_middle_of_a_room_outward_is_no_thing(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    eyes = rng.normal(0, 0.2, (count, 3))
    assert not orbits_one_object(frames(eyes, 3 * ring(count)))


def test_along_a_wall_is_no_thing() -> None:
    eyes = np.stack([np.linspace(0, 3, 12), np.zeros(12), np.zeros(12)], axis=1)
    assert not orbits_one_object(frames(eyes, eyes + np.array([0, 0, 1.0])))


def test_some_photos_of_something_else_change_nothing() -> None:
    eyes = ring(20)
    targets = np.zeros((20, 3))
    targets[::10] = [5, 5, 5]
    found = frames(eyes, targets)
    axes = np.stack([frame.camera_to_world[:3, 2] for frame in found])
    assert np.linalg.norm(meeting_point(eyes, axes)) < 1e-3
    assert orbits_one_object(found)


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
