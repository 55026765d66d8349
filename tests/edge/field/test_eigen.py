"""The closed-form eigen-solve against the iterative one."""

from __future__ import annotations

import numpy as np
import pytest

from capture2vr.edge.field.eigen import smallest_eigenvectors


@pytest.mark.parametrize("flatness", [1.0, 1e-2, 1e-6, 0.0])
@pytest.mark.parametrize("size", [1.0, 1e-8])
def test_it_finds_the_direction_of_least_spread(flatness: float, size: float) -> None:
    points = np.random.default_rng(0).normal(size=(2_000, 12, 3)) * [1, 0.6, 0.3 * flatness]
    turns = np.linalg.qr(np.random.default_rng(1).normal(size=(2_000, 3, 3)))[0]
    points = np.matmul(points, turns) * np.sqrt(size)
    matrices = np.matmul(points.transpose(0, 2, 1), points)
    found = smallest_eigenvectors(matrices)
    values, vectors = np.linalg.eigh(matrices)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, atol=1e-9)
    spread = np.einsum("nx,nxy,ny->n", found, matrices, found)
    np.testing.assert_allclose(spread, values[:, 0], atol=1e-9 * size)
    apart = values[:, 1] > 1.1 * values[:, 0]
    assert np.abs(np.einsum("nx,nx->n", found, vectors[:, :, 0]))[apart].min() > 1 - 1e-6


def test_sets_without_extent_stay_finite() -> None:
    matrices = np.array([np.zeros((3, 3)), np.eye(3), np.diag([1.0, 0, 0]), np.full((3, 3), 1e-200)])
    assert np.isfinite(smallest_eigenvectors(matrices)).all()
