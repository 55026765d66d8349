"""The asset frame: metres, Y up, origin on the floor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from capture2vr.edge.asset.manifest import asset_frame, rotation_between
from capture2vr.edge.points.nouns import Points
from capture2vr.order.edits import Edits

directions = (
    arrays(np.float64, 3, elements=st.floats(-1, 1))
    .filter(lambda v: np.linalg.norm(v) > 1e-3)
    .map(lambda v: v / np.linalg.norm(v))
)


@given(directions, directions)
def test_a_rotation_turns_one_direction_into_the_other(source: np.ndarray, target: np.ndarray) -> None:
    rotation = rotation_between(source, target)
    assert rotation @ source == pytest.approx(target, abs=1e-6)
    assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-6)
    assert np.linalg.det(rotation) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("axis", range(3))
def test_half_turns_are_rotations_too(axis: int) -> None:
    up = np.eye(3)[axis]
    rotation = rotation_between(up, -up)
    assert rotation @ up == pytest.approx(-up)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


def _points(xyz: np.ndarray, up: np.ndarray | None, metres_per_unit: float) -> Points:
    return Points(xyz, None, np.ones(len(xyz), np.float32), metres_per_unit, "metric", up)


@given(directions, directions)
def test_the_front_looks_to_whoever_stands_before_the_asset(up: np.ndarray, front: np.ndarray) -> None:
    xyz = np.random.default_rng(0).random((50, 3))
    points = replace(_points(xyz, up, 2.0), edits=Edits(front=tuple(front.tolist())))
    rotation = asset_frame(xyz, points)[:3, :3] / 2.0
    assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-6)
    assert rotation @ up == pytest.approx([0, 1, 0], abs=1e-6)
    x, _, z = rotation @ front
    assert np.hypot(x, z) < 1.1e-3 or (abs(x) < 1e-6 and z > 0)


@given(directions, st.floats(1e-3, 1e3), arrays(np.float64, 3, elements=st.floats(-1e5, 1e5)))
def test_the_asset_stands_on_the_floor_above_the_origin(up: np.ndarray, scale: float, offset: np.ndarray) -> None:
    xyz = np.random.default_rng(0).random((50, 3)) + offset
    to_asset = asset_frame(xyz, _points(xyz, up, scale))
    placed = xyz @ to_asset[:3, :3].T + to_asset[:3, 3]
    low, high = placed.min(axis=0), placed.max(axis=0)
    assert low[1] == pytest.approx(0, abs=1e-6 * scale)
    assert (low + high)[[0, 2]] == pytest.approx(0, abs=1e-6 * scale)
    # What is higher against gravity in the capture is higher in the asset, by the same length in metres.
    rise = (xyz[1] - xyz[0]) @ up * scale
    assert (placed[1] - placed[0])[1] == pytest.approx(rise, abs=1e-6 * scale)
