"""What was seen from afar is not needed where others saw it from near; what nobody saw from nearer always is."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.nouns import Intrinsics
from capture2vr.edge.fusion.fuse import fuse
from capture2vr.edge.fusion.fuse_scene import fuse_scene
from capture2vr.edge.fusion.viewing_distance import ViewingDistance
from tests.support.scenes import Sensor, film, look_at, scene

WALL = np.random.default_rng(0).uniform([-1, 0, -1], [1, 1e-3, 1], (2_000, 3))
"""Places of a wall at Y = 0."""


def eyes_at(distance: float, count: int = len(WALL)) -> Floats:
    return np.tile([0.0, -distance, 0.0], (count, 1))


@given(st.integers(0, 2**32 - 1))
def test_what_nobody_saw_from_much_nearer_is_needed(seed: int) -> None:
    rng = np.random.default_rng(seed)
    places, eyes = rng.uniform(-10, 10, (300, 3)), rng.uniform(-10, 10, (300, 3))
    seen = ViewingDistance.of(places, eyes)
    away = np.linalg.norm(places - eyes, axis=1)
    needed = seen.is_near(places, eyes)
    assert needed[away < 2.5].all()
    assert needed[away.argmin()]
    alone, eye = np.array([[50.0, 0, 0]]), np.array([[50.0, 7, 0]])
    assert ViewingDistance.of(alone, eye).is_near(alone, eye).all()


@given(st.floats(1.5, 3))
def test_a_wall_that_was_seen_from_near_needs_no_look_from_afar(near_m: float) -> None:
    seen = ViewingDistance.of(np.concatenate([WALL, WALL]), np.concatenate([eyes_at(near_m), eyes_at(8)]))
    assert seen.is_near(WALL, np.array([0.0, -1.5 * near_m, 0])).all()
    assert not seen.is_near(WALL, np.array([0.0, -8, 0])).any()


def test_the_other_side_of_a_wall_is_another_part() -> None:
    behind = np.add(WALL, [0, 0.1, 0])
    seen = ViewingDistance.of(np.concatenate([WALL, behind]), np.concatenate([eyes_at(1), eyes_at(-7)]))
    assert seen.is_near(behind, np.array([0.0, 7, 0])).all()
    assert not seen.is_near(WALL, np.array([0.0, -7, 0])).any()


@pytest.mark.slow
def test_a_noisy_look_through_a_long_corridor_adds_no_layers_to_a_wall() -> None:
    """The nearer views show the middle of one of two walls. All else is there too, as exact as 6 m allow."""
    walls = [trimesh.creation.box((2.0, 0.02, 2.0)) for _ in range(2)]
    walls[1].apply_translation((2.5, 0, 0))
    world = scene((walls[0], (200, 80, 60)), (walls[1], (60, 80, 200)))
    near = [look_at((x, -1.5, 0), (x / 2, 0, 0)) for x in np.linspace(-0.4, 0.4, 6)]
    far = [look_at((x, -6, 0), (1.25, 0, 0)) for x in np.linspace(0, 2.5, 30)]
    camera = Intrinsics(fx=200.0, fy=200.0, cx=127.5, cy=95.5, width=256, height=192)  # the nearer views see 1.4 m high
    frames = film(world, np.stack([*near, *far]), camera, Sensor(noise_m=0.0025))

    fused = fuse_scene(frames, voxel=0.01, most=10_000, most_of_box=200_000)
    assert fused.whole is not None
    boxed = np.concatenate([part.xyz for part in fused.whole.read()])
    at_once = fuse(frames, voxel=0.01).xyz
    middle = (0.0, 0.8, 0.0, 0.55)
    assert np.mean(away_in(boxed, *middle) > 0.02) < 0.002 < np.mean(away_in(at_once, *middle) > 0.02)
    assert len(away_in(boxed, *middle)) > 0.9 * 1.6 * 1.1 / 0.01**2
    for part in ((0.0, 0.8, 0.85, 0.1), (0.0, 0.8, -0.85, 0.1), (2.5, 0.9, 0.0, 0.9)):
        assert len(away_in(boxed, *part)) > 0.8 * len(away_in(at_once, *part)) > 100, "seen from afar alone"


def away_in(xyz: Floats, x: float, half_x: float, z: float, half_z: float) -> Floats:
    """Distances from the front of a wall, of the points in a part of it."""
    inside = (np.abs(xyz[:, 0] - x) < half_x) & (np.abs(xyz[:, 2] - z) < half_z)
    return np.abs(xyz[inside, 1] + 0.01)
