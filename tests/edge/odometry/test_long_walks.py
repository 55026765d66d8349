"""Loops of long walks: wrong alignments are outvoted, and only key frames near each other are compared."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from capture2vr.edge.arrays import Floats
from capture2vr.edge.odometry import loop_closure
from capture2vr.edge.odometry.pose_graph import Edge, optimise_poses
from capture2vr.edge.odometry.pyramid import PackedLevel, PyramidLevel
from tests.support.scenes import PHONE, look_at

SURE = np.eye(6) * 4e8
"""Information of an alignment of thousands of pixels: a millimetre counts."""


def round_walk(count: int) -> Floats:
    """(count,4,4) poses of a walk around a square of 8 m, looking ahead."""
    angles = np.linspace(0, 2 * np.pi, count, endpoint=False)
    eyes = np.stack([4 * np.cos(angles), 4 * np.sin(angles), np.full(count, 1.5)], axis=1)
    return np.stack(
        [look_at(eye, np.add(eye, (-np.sin(a), np.cos(a), -0.3))) for eye, a in zip(eyes, angles, strict=True)]
    )


def measured(poses: Floats, old: int, new: int, *, off_m: float = 0.0) -> Edge:
    pose = np.linalg.inv(poses[old]) @ poses[new]
    pose[0, 3] += off_m
    return Edge(old, new, pose, SURE)


def chained(edges: list[Edge]) -> Floats:
    """Poses of following edges one after the other."""
    poses = [np.eye(4)]
    for edge in edges:
        poses.append(poses[-1] @ edge.pose)
    return np.stack(poses)


@pytest.mark.parametrize("count", [40, 400])
def test_loops_outvote_steps_that_are_wrong(count: int) -> None:
    """Three steps of the way are a quarter of a metre off, as along a wallpaper that repeats itself."""
    truth = np.linalg.inv(round_walk(count)[0]) @ round_walk(count)
    wrong = {count // 5, count // 2, count - 4}
    steps = [measured(truth, at, at + 1, off_m=0.25 * (at in wrong)) for at in range(count - 1)]
    loops = [measured(truth, at, (at + 2) % count) for at in range(count - 1)]
    drifted = chained(steps)
    assert np.linalg.norm(drifted[-1, :3, 3] - truth[-1, :3, 3]) > 0.05
    np.testing.assert_allclose(optimise_poses(drifted, steps + loops), truth, atol=1e-4)


def test_noise_is_spread_over_the_way_when_it_returns() -> None:
    count, rng = 100, np.random.default_rng(0)
    truth = np.linalg.inv(round_walk(count)[0]) @ round_walk(count)
    steps = []
    for at in range(count - 1):
        turn = np.eye(4)
        turn[:3, :3] = Rotation.from_rotvec(rng.normal(0, 2e-3, 3)).as_matrix()
        steps.append(Edge(at, at + 1, np.linalg.inv(truth[at]) @ truth[at + 1] @ turn, np.eye(6) * 1e8))
    drifted = chained(steps)
    closed = optimise_poses(drifted, [*steps, measured(truth, 0, count - 1)])
    end, before = (np.linalg.norm(poses[-1, :3, 3] - truth[-1, :3, 3]) for poses in (closed, drifted))
    assert end < 0.1 * before


def test_packed_levels_come_back_nearly_exact() -> None:
    rng = np.random.default_rng(0)
    q = rng.uniform(0.1, 5, (48, 64)).astype(np.float32)
    q[:5] = 0
    level = PackedLevel.of(PyramidLevel(PHONE, q, rng.random((48, 64), np.float32))).unpacked()
    np.testing.assert_allclose(level.inverse_depth, q, rtol=5e-4)
    assert not level.inverse_depth[:5].any()
    assert PackedLevel.of(PyramidLevel(PHONE, q, None)).unpacked().grey is None


@pytest.mark.slow
def test_far_key_frames_are_not_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    """Along a corridor, ten times as many key frames make about ten times as many comparisons."""
    asked: list[Floats] = []
    overlap = loop_closure._overlap

    def counted(old: PackedLevel, points: Floats, between: Floats) -> float:
        asked.append(between)
        return overlap(old, points, between)

    monkeypatch.setattr(loop_closure, "_overlap", counted)
    key = PackedLevel.of(PyramidLevel(PHONE, np.full((PHONE.height, PHONE.width), 0.5, np.float32), None))
    counts = []
    for length in (60, 600):
        asked.clear()
        poses = np.stack([look_at((0.3 * at, 0, 1), (0.3 * at, 2, 1)) for at in range(length)])
        pairs = loop_closure._overlapping_pairs([key] * length, poses)
        assert {new for _, new in pairs} == set(range(2, length))
        counts.append(len(asked))
    assert counts[1] < 13 * counts[0]
