"""The transform of least squares between points and their partners."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from capture2vr.edge.procrustes import procrustes


@given(seed=st.integers(0, 2**32 - 1), scale=st.floats(1e-3, 1e3))
def test_it_finds_the_transform_that_was_applied(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(20, 3))
    turn, shift = Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)
    found = procrustes(points, scale * points @ turn.T + shift, scale=True)
    assert found is not None
    np.testing.assert_allclose(found[:3, :3], scale * turn, atol=1e-9 * scale)
    np.testing.assert_allclose(found[:3, 3], shift, atol=1e-9 * max(scale, 1))


def test_a_rigid_motion_keeps_sizes_and_never_mirrors() -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(50, 3))
    found = procrustes(points, 3 * points * [1, 1, -1], scale=False)
    assert found is not None
    np.testing.assert_allclose(found[:3, :3] @ found[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(found[:3, :3]) == pytest.approx(1)


@pytest.mark.parametrize("scale", [True, False])
def test_points_at_one_place_say_nothing(scale: bool) -> None:
    assert procrustes(np.ones((3, 3)), np.eye(3), scale=scale) is None
