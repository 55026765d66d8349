"""New points between neighbours of the grid: on the surface, and never across a gap."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Floats
from tests.bench.single_photo_network.densify import densify
from tests.bench.single_photo_network.network import GRID, POINTS


def sheet(*, gap: float = 0.0, height: float = 0.0) -> Floats:
    """The grid as a sheet of 1 x 1, wavy, with a gap between its halves."""
    x, y = np.meshgrid(np.linspace(0, 1, GRID), np.linspace(0, 1, GRID))
    x = x + gap * (x > 0.5)
    return np.stack([x, y, height * np.sin(6 * x)], axis=-1).reshape(-1, 3)


def test_a_sheet_gets_points_in_the_middle_of_every_edge_and_cell() -> None:
    dense = densify(sheet())
    assert len(dense) == (2 * GRID - 1) ** 2
    apart, _ = cKDTree(dense).query(dense, k=2)
    assert np.allclose(apart[:, 1], 0.5 / (GRID - 1))


@settings(max_examples=20)
@given(st.floats(0.0, 3.0), st.floats(0.0, 0.5), st.integers(0, 99))
def test_the_points_stay_and_new_ones_lie_among_them(gap: float, height: float, seed: int) -> None:
    points = sheet(gap=gap, height=height) + np.random.default_rng(seed).normal(0, 1e-3, (POINTS, 3))
    dense = densify(points)
    assert np.array_equal(dense[:POINTS], points)
    assert (dense.min(axis=0) >= points.min(axis=0)).all()
    assert (dense.max(axis=0) <= points.max(axis=0)).all()


def test_nothing_is_laid_across_a_gap() -> None:
    points = sheet(gap=0.5)
    within = points[:, 0].max() - 0.98, points[:, 0].min() + 0.52
    dense = densify(points)
    assert not ((dense[:, 0] > within[1]) & (dense[:, 0] < within[0])).any()
    assert len(dense) == (2 * GRID - 1) * (2 * GRID - 2)
