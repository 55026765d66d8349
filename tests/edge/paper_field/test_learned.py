"""A network as a field: what extraction expects of it, near the points and far from them."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Floats
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.paper_field.learned import CHUNK, learned_field
from capture2vr.edge.paper_field.network_config import NetworkConfig
from capture2vr.edge.paper_field.networks import network_of
from tests.support import surfaces

POINTS = surfaces.sampled(surfaces.disk(), 1_000)
NETWORK = network_of(NetworkConfig())
FIELD = learned_field(NETWORK, POINTS)


def test_near_the_points_it_is_the_network_with_gradients_of_length_1() -> None:
    f, gradient = FIELD(POINTS)
    expected, slope = NETWORK.value_and_gradient(torch.from_numpy(POINTS).float())
    np.testing.assert_allclose(f, expected.detach().numpy(), atol=1e-6)
    unit = torch.nn.functional.normalize(slope).detach().numpy()
    np.testing.assert_allclose(gradient, unit, atol=1e-5)
    assert f.dtype == gradient.dtype == np.float32


def test_far_from_the_points_it_is_the_distance_to_them() -> None:
    # A random network has a sphere of radius ½ for its zero set, which the disk has no part of at its poles.
    poles = np.array([[0, 0, 0.5], [0, 0, -0.5]])
    f, gradient = FIELD(poles)
    away, index = cKDTree(POINTS).query(poles)
    np.testing.assert_allclose(f, away, atol=1e-6)
    np.testing.assert_allclose(gradient, (poles - POINTS[index]) / away[:, None], atol=1e-5)


def test_chunks_leave_no_seam_and_no_queries_are_no_error() -> None:
    queries = np.random.default_rng(0).uniform(-0.6, 0.6, (CHUNK["cpu"] + 100, 3))
    f, gradient = FIELD(queries)
    np.testing.assert_allclose(FIELD(queries[-150:])[0], f[-150:], atol=1e-6)
    assert np.isfinite(gradient).all()
    assert FIELD(np.empty((0, 3)))[0].shape == (0,)


def test_it_evaluates_the_weights_as_they_stand() -> None:
    network = network_of(NetworkConfig())
    field = learned_field(network, POINTS)
    before = field(POINTS)[0]
    with torch.no_grad():
        network.out_bias += 0.1  # type: ignore[operator]
    assert np.abs(field(POINTS)[0] - before).mean() > 0.01


def test_a_gpu_that_is_full_when_the_field_is_asked_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(q: Floats) -> tuple[Floats, Floats]:
        raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2 GiB.")

    monkeypatch.setattr(FIELD, "_evaluate_network", full)
    with pytest.raises(EdgeError) as raised:
        FIELD(POINTS)
    assert raised.value.code == "GPU_OOM"
