"""Ground that is not quite a plane: its bend is found, and goes no farther than allowed."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from capture2vr.edge.points.ground import Ground
from capture2vr.edge.points.plane import Plane

_FLAT = Plane(np.array([0.0, 0.0, 1.0]), 0.0, 0.002, 0.8)


def _bent(rng: np.random.Generator, terms: tuple[float, float, float], noise: float) -> np.ndarray:
    u, v = rng.uniform(-0.5, 0.5, (2, 4_000))
    a, b, c = terms
    return np.stack([u, v, a * u * u + b * u * v + c * v * v + rng.normal(0, noise, len(u))], axis=1)


@settings(deadline=None, max_examples=25)
@given(st.tuples(*[st.floats(-0.03, 0.03)] * 3), st.integers(0, 99))
def test_the_bend_is_found(terms: tuple[float, float, float], seed: int) -> None:
    xyz = _bent(np.random.default_rng(seed), terms, 0.001)
    ground = Ground.about(_FLAT, xyz, half=0.012, most=0.1)
    assert np.abs(np.median(ground.height(xyz))) < 2e-4
    assert ground.height(xyz).std() < 1.2e-3


def test_what_stands_on_the_ground_does_not_bend_it() -> None:
    rng = np.random.default_rng(0)
    xyz = _bent(rng, (0.03, 0.0, 0.0), 0.001)
    wall = np.stack([np.full(2_000, 0.1), rng.uniform(-0.1, 0.1, 2_000), rng.uniform(0.0, 0.4, 2_000)], axis=1)
    ground = Ground.about(_FLAT, np.concatenate([xyz, wall]), half=0.012, most=0.1)
    assert ground.height(xyz).std() < 1.3e-3
    assert ground.height(wall).max() > 0.38


def test_the_bend_ends_at_its_limit() -> None:
    xyz = _bent(np.random.default_rng(0), (0.03, 0.0, 0.0), 0.001)
    ground = Ground.about(_FLAT, xyz, half=0.012, most=0.02)
    far = np.array([[10.0, 0.0, 1.0], [0.0, 0.0, 1.0]])  # the quadratic would be 3 high there
    np.testing.assert_allclose(ground.height(far), [0.98, 1.0], atol=1e-3)


def test_few_points_leave_a_plane() -> None:
    xyz = _bent(np.random.default_rng(0), (0.03, 0.0, 0.0), 0.001)[:50]
    np.testing.assert_array_equal(Ground.about(_FLAT, xyz, 0.012, 0.1).height(xyz), xyz[:, 2])
