"""The densification round: thinning, and points that a fitted field adds."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from capture2vr.edge.paper_field.densify import densify_points, poisson_disk
from capture2vr.edge.paper_field.network_config import Densify, NetworkConfig
from capture2vr.edge.paper_field.networks import FieldNetwork
from capture2vr.edge.paper_field.queries import draw_pool


class Sphere(FieldNetwork):
    """The exact field of a sphere of radius ½, in a network's place."""

    def forward(self, q: Tensor) -> Tensor:
        return (q.norm(dim=1) - 0.5).abs()

    def value_and_gradient(self, q: Tensor) -> tuple[Tensor, Tensor]:
        return self(q), q / q.norm(dim=1, keepdim=True) * (q.norm(dim=1, keepdim=True) - 0.5).sign()


def on_sphere(count: int) -> np.ndarray:
    xyz = np.random.default_rng(3).normal(size=(count, 3))
    return np.asarray(0.5 * xyz / np.linalg.norm(xyz, axis=1, keepdims=True), np.float32)


def test_thinned_points_keep_apart_and_leave_no_gap() -> None:
    xyz = on_sphere(5_000)
    kept = xyz[poisson_disk(xyz, 0.05, seed=0)]
    assert cKDTree(kept).query(kept, k=2)[0][:, 1].min() > 0.05
    assert cKDTree(kept).query(xyz)[0].max() <= 0.05
    assert poisson_disk(xyz, 1e-9, seed=0).all()


def test_added_points_lie_on_the_surface_near_the_input_and_apart() -> None:
    xyz = on_sphere(2_000)
    *_, pool = draw_pool(xyz, NetworkConfig(), torch.device("cpu"))
    assert pool is not None
    *_, added = densify_points(Sphere(), pool, Densify(growth=1.0, farthest=0.02), seed=0)
    assert added is not None
    assert 0.4 * 2_000 < len(added) <= 2_000
    assert np.abs(np.linalg.norm(added, axis=1) - 0.5).max() < 1e-5
    assert cKDTree(xyz).query(added)[0].max() < 0.02
    assert cKDTree(added).query(added, k=2)[0][:, 1].min() > 0.01


def test_what_lies_far_from_the_input_is_not_added() -> None:
    xyz = on_sphere(500)
    *_, pool = draw_pool(xyz, NetworkConfig(), torch.device("cpu"))
    assert pool is not None
    *_, added = densify_points(Sphere(), pool, Densify(growth=1.0, farthest=0.003), seed=0)
    assert added is not None
    assert len(added) == 0 or cKDTree(xyz).query(added)[0].max() < 0.003
