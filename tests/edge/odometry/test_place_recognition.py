"""Places are found again by their pictures, whatever the poses say, and loops are closed by them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.edge.arrays import Floats, no_tick
from services.edge.odometry import loop_closure
from services.edge.odometry.features import Features
from services.edge.odometry.loop_closure import close_loops
from services.edge.odometry.place_recognition import similar_pairs
from services.edge.odometry.pose_graph import Edge
from services.edge.odometry.pyramid import PackedLevel
from tests.edge.odometry.test_tracker import ORBIT, SENSOR, levels, things


def pictures(places: list[int], seed: int) -> list[Features]:
    """Features of pictures of places: those of a place are the same but for noise, and some are new each time."""
    found = []
    for number, place in enumerate(places):
        own, new = np.random.default_rng(place), np.random.default_rng((seed, number))
        descriptors = np.concatenate([own.integers(0, 120, (60, 128)), new.integers(0, 120, (40, 128))])
        noisy = np.clip(descriptors + new.normal(0, 8, descriptors.shape), 0, 255).astype(np.uint8)
        found.append(Features(np.zeros((100, 3), np.float32), noisy))
    return found


@settings(max_examples=10)
@given(st.permutations(range(8)), st.integers(0, 100))
def test_a_place_is_known_again(order: list[int], seed: int) -> None:
    seen = pictures([*range(8), *order], seed)
    pairs = similar_pairs(seen, apart=1, most=1)
    assert {(old, new) for old, new in pairs if new >= 8} == {(place, 8 + at) for at, place in enumerate(order)}


def test_neighbours_and_pictures_without_features_are_left_out() -> None:
    seen: list[Features | None] = [*pictures([0, 0, 0, 0], 0)]
    assert similar_pairs(seen, apart=3, most=2) == [(0, 3)]
    seen[0] = None
    assert similar_pairs(seen, apart=3, most=2) == []
    assert similar_pairs([None, None], apart=1, most=1) == []


def drifted(truth: Floats, at: int, off_m: float) -> tuple[Floats, list[Edge]]:
    """Poses that follow the truth but for one step, and the steps."""
    steps, poses = [], [np.eye(4)]
    for number in range(len(truth) - 1):
        step = np.linalg.inv(truth[number]) @ truth[number + 1]
        step[0, 3] += off_m * (number == at)
        steps.append(Edge(number, number + 1, step, np.eye(6) * 4e7))
        poses.append(poses[-1] @ step)
    return np.stack(poses), steps


@pytest.mark.slow
def test_a_loop_is_closed_although_the_poses_have_gone_metres_away(monkeypatch: pytest.MonkeyPatch) -> None:
    """Twice around a table, of which the second time is three metres away by the poses: nothing overlaps."""
    around = np.concatenate([ORBIT, ORBIT[:6]])
    world = things()
    keys = [PackedLevel.of(levels(pose, world, noise_m=SENSOR.noise_m, seed=at)[-1]) for at, pose in enumerate(around)]
    truth = np.linalg.inv(around[0]) @ around
    poses, steps = drifted(truth, 17, 3.0)
    monkeypatch.setattr(loop_closure, "_LONG_AGO", 15)
    closed = close_loops(keys, poses, steps, no_tick)
    assert len(closed.loops) > 6, "those that look alike, and then those that overlap"
    assert np.linalg.norm(closed.poses[:, :3, 3] - truth[:, :3, 3], axis=1).max() < 0.01
