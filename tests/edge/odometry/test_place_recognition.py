"""Places are found again by their pictures, whatever the poses say, and loops are closed by them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture2vr.edge.arrays import Floats, no_tick
from capture2vr.edge.odometry import loop_closure
from capture2vr.edge.odometry.features import RgbdFeatures
from capture2vr.edge.odometry.loop_closure import close_loops
from capture2vr.edge.odometry.place_recognition import similar_pairs
from capture2vr.edge.odometry.pose_graph import Edge
from capture2vr.edge.odometry.pyramid import PackedLevel
from tests.edge.odometry.test_tracker import ORBIT, SENSOR, levels, things


def pictures(places: list[int], seed: int) -> list[RgbdFeatures]:
    """Features of pictures of places: those of a place are the same but for noise, and some are new each time."""
    found = []
    for number, place in enumerate(places):
        own, new = np.random.default_rng(place), np.random.default_rng((seed, number))
        descriptors = np.concatenate([own.integers(0, 120, (60, 128)), new.integers(0, 120, (40, 128))])
        noisy = np.clip(descriptors + new.normal(0, 8, descriptors.shape), 0, 255).astype(np.uint8)
        found.append(RgbdFeatures(np.zeros((100, 3), np.float32), noisy))
    return found


@settings(max_examples=10)
@given(st.permutations(range(8)), st.integers(0, 100))
def test_a_place_is_known_again(order: list[int], seed: int) -> None:
    pairs = similar_pairs(pictures([*range(8), *order], seed), [np.arange(min(new, 8)) for new in range(16)])
    assert {(old, new) for old, new in pairs if new >= 8} == {(place, 8 + at) for at, place in enumerate(order)}


def test_pictures_without_features_or_others_to_compare_with_have_no_pair() -> None:
    seen: list[RgbdFeatures | None] = [*pictures([0, 0, 0, 0], 0)]
    olds = [np.array([], int)] * 3 + [np.array([0])]
    assert similar_pairs(seen, olds) == [(0, 3)]
    seen[0] = None
    assert similar_pairs(seen, olds) == []
    assert similar_pairs([None, None], olds[2:]) == []


def drifted(truth: Floats, at: int, off_m: float) -> tuple[Floats, list[Edge]]:
    """Poses that follow the truth but for one step, and the steps."""
    steps, poses = [], [np.eye(4)]
    for number in range(len(truth) - 1):
        step = np.linalg.inv(truth[number]) @ truth[number + 1]
        step[0, 3] += off_m * (number == at)
        steps.append(Edge(number, number + 1, step, np.eye(6) * 4e7))
        poses.append(poses[-1] @ step)
    return np.stack(poses), steps


def twice_around() -> tuple[list[PackedLevel], Floats]:
    """Key frames of one and a third rounds of a table, and their poses as seen from the first."""
    around = np.concatenate([ORBIT, ORBIT[:6]])
    world = things()
    keys = [PackedLevel.of(levels(pose, world, noise_m=SENSOR.noise_m, seed=at)[-1]) for at, pose in enumerate(around)]
    return keys, np.linalg.inv(around[0]) @ around


@pytest.mark.slow
def test_a_loop_is_closed_when_the_poses_have_drifted_as_far_as_may_be(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the poses the second round is metres away. Where so much drift cannot be, that is another table."""
    keys, truth = twice_around()
    poses, steps = drifted(truth, 17, 3.0)
    monkeypatch.setattr(loop_closure, "_LONG_AGO", 15)
    monkeypatch.setattr(loop_closure, "_MEETING_M", 1.0)
    other = close_loops(keys, poses, steps, no_tick)
    assert max(edge.source for edge in other.loops if edge.target < 15) < 18, (
        "the first round has no loop to the second"
    )
    assert np.linalg.norm(other.poses[:, :3, 3] - poses[:, :3, 3], axis=1).max() < 0.01
    monkeypatch.setattr(loop_closure, "_DRIFT_SHARE", 1.0)
    closed = close_loops(keys, poses, steps, no_tick)
    assert np.linalg.norm(closed.poses[:, :3, 3] - truth[:, :3, 3], axis=1).max() < 0.01
