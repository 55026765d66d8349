"""Points that all lie on one plane are told from those of a thing."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from capture2vr.edge.points.flatness import flatness_warning


@given(st.integers(0, 2**32 - 1), st.floats(0.1, 10), st.floats(0, 0.01))
def test_a_screen_is_flat_however_it_hangs_and_with_a_few_points_before_it(
    seed: int, size: float, noise: float
) -> None:
    rng = np.random.default_rng(seed)
    screen = rng.uniform(-1, 1, (2_000, 3)) * [1.6, 1.0, 0] + noise * rng.normal(size=(2_000, 3)) * [0, 0, 1]
    before = rng.uniform(-1, 1, (100, 3))
    xyz = size * Rotation.random(random_state=seed).apply(np.concatenate([screen, before])) + rng.normal(size=3)
    (warning,) = flatness_warning(xyz)
    assert "photograph the object itself" in warning


@pytest.mark.slow
@given(st.integers(0, 2**32 - 1), st.floats(0.25, 1.0))
def test_a_dish_and_a_box_are_not(seed: int, depth: float) -> None:
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-1, 1, (2_000, 2))
    dish = np.column_stack([xy, depth * (xy**2).sum(axis=1)])
    assert flatness_warning(dish) == ()
    box = rng.uniform(-1, 1, (2_000, 3)) * [1, 1, depth]
    assert flatness_warning(box) == ()
