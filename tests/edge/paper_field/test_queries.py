"""The pool, its pairs and its batches; and the searches for nearest points."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from capture2vr.edge.field.compute import nearest, nearest_by_blocks, rows
from capture2vr.edge.paper_field.network_config import NetworkConfig, pool_size
from capture2vr.edge.paper_field.queries import PADDING, Batches, Pool, draw_pool
from tests.support import surfaces

CPU = torch.device("cpu")
POINTS = np.asarray(surfaces.sampled(surfaces.hemisphere(), 2_000), np.float32)
CONFIG = NetworkConfig(pool=20_000, weak_per_m2=250.0, far_share=0.05)


def drawn(config: NetworkConfig = CONFIG, points: np.ndarray = POINTS, metres: float | None = None) -> Pool:
    *_, pool = draw_pool(points, config, CPU, metres)
    assert pool is not None
    return pool


@pytest.mark.slow
def test_a_pair_shares_its_offset_and_its_weak_anchor_is_of_the_subset() -> None:
    pool, j = drawn(), torch.arange(20_000)
    between = pool.weak_queries(j) - pool.strong_queries(j)
    anchors = pool.points[pool.weak[pool.anchor]] - pool.points[pool.anchor]
    torch.testing.assert_close(between, anchors, atol=1e-6, rtol=0)
    members = pool.weak.unique()
    assert len(members) == 500
    assert (pool.weak[members] == members).all()
    to_subset = cKDTree(POINTS[members]).query(POINTS)[0]
    np.testing.assert_allclose(anchors.norm(dim=1), to_subset[pool.anchor], atol=1e-6)


def test_every_point_anchors_as_many_queries_as_far_away_as_its_neighbours() -> None:
    pool = drawn()
    counts = torch.bincount(pool.anchor)
    assert counts.min() == counts.max() == 10
    sigma = 0.25 * cKDTree(POINTS).query(POINTS, k=51)[0][:, -1]  # ¼ below 20,000 points
    assert (pool.offset / torch.from_numpy(sigma)[pool.anchor, None]).std() == pytest.approx(1, abs=0.02)


@pytest.mark.parametrize("per_m2", [100.0, 400.0])
def test_strong_anchors_are_as_dense_as_asked_for_and_weak_ones_a_part_of_them(per_m2: float) -> None:
    # A hemisphere of 2 m: 2π m².
    config = NetworkConfig(pool=20_000, strong_per_m2=per_m2, weak_per_m2=per_m2 / 4)
    pool = drawn(config, metres=2.0)
    strong, weak = pool.anchor.unique(), pool.weak.unique()
    if 2 * np.pi * per_m2 > len(POINTS):
        assert len(strong) == len(POINTS)
    else:
        assert len(strong) == pytest.approx(2 * np.pi * per_m2, rel=0.15)
    assert len(weak) == round(len(strong) / 4)
    assert set(weak.tolist()) <= set(strong.tolist())
    assert len(drawn(config).anchor.unique()) == len(POINTS), "of no known unit"


@pytest.mark.parametrize("metres", [0.3, 0.02])
def test_of_a_small_thing_queries_still_reach_all_points(metres: float) -> None:
    # A hemisphere of 30 cm has 141 anchors at 1,000 per square metre, one of 2 cm not even one.
    pool = drawn(NetworkConfig(pool=20_000), metres=metres)
    strong = pool.anchor.unique()
    assert len(strong) == pytest.approx(max(51, 2 * np.pi * (metres / 2) ** 2 * 1_000), rel=0.15)
    assert len(pool.nearest.unique()) > 0.9 * len(POINTS)
    sigma = 0.25 * cKDTree(POINTS[strong]).query(POINTS[strong], k=51)[0][:, -1]
    spread = pool.offset / torch.from_numpy(sigma)[torch.searchsorted(strong, pool.anchor), None]
    assert spread.std() == pytest.approx(1, abs=0.02)


def test_dense_clouds_spread_their_queries_wider() -> None:
    many = np.random.default_rng(0).random((30_000, 3)).astype(np.float32)
    pool = drawn(NetworkConfig(pool=30_000), many)
    sigma = 0.25 * 1.5**0.5 * cKDTree(many).query(many[:500], k=51)[0][:, -1]  # ¼·√(30,000/20,000)
    spread = pool.offset[pool.anchor.argsort()][:500] / torch.from_numpy(sigma)[:, None]
    assert spread.std() == pytest.approx(1, abs=0.05)


def test_nearest_points_and_far_distances_are_those_of_the_points() -> None:
    pool = drawn()
    tree = cKDTree(POINTS)
    assert (tree.query(pool.strong_queries(torch.arange(20_000)).numpy())[1] == pool.nearest.numpy()).mean() > 0.999
    np.testing.assert_allclose(pool.far_distance, tree.query(pool.far.numpy())[0], atol=1e-6)
    assert (pool.far.numpy() > POINTS.min(axis=0) - PADDING - 1e-6).all()
    assert len(pool.far) == 1_000


def test_small_clouds_draw_small_pools() -> None:
    assert pool_size(1_000, NetworkConfig()) == 100_000
    assert pool_size(50_000, NetworkConfig()) == 1_000_000


def test_a_seed_draws_one_pool() -> None:
    for a, b in ((drawn(), drawn()), (drawn(), drawn(NetworkConfig(pool=20_000, seed=1)))):
        same = torch.equal(a.offset, b.offset)
        assert same == (a.offset[0, 0] == b.offset[0, 0])
    assert torch.equal(drawn().offset, drawn().offset)


def test_batches_go_through_the_pool_and_depend_on_the_step_alone() -> None:
    batches = Batches(1_000, 300, 7, CPU)
    epoch = torch.cat([batches.at(step) for step in range(3)])
    assert len(epoch.unique()) == 900
    later = batches.at(4)
    assert not torch.equal(later, batches.at(1))
    assert torch.equal(Batches(1_000, 300, 7, CPU).at(4), later)
    assert Batches(100, 300, 7, CPU).size == 100


@pytest.mark.parametrize("block_bytes", [1, 50_000, 1 << 28])
def test_the_gpus_search_finds_what_the_tree_finds(block_bytes: int) -> None:
    queries = torch.from_numpy(POINTS[:400]) + 0.01
    points = torch.from_numpy(POINTS[: 300 if block_bytes == 1 else 2_000])
    found = nearest_by_blocks(queries, points, block_bytes)
    away = (queries - points[found]).square().sum(dim=1)
    np.testing.assert_allclose(away, np.square(cKDTree(points.numpy()).query(queries.numpy())[0]), atol=5e-7)
    assert (nearest(queries, points) == found).float().mean() > 0.99


def test_rows_adds_up_the_gradients_of_repeated_rows() -> None:
    table = torch.rand(5, 3, requires_grad=True)
    rows(table, torch.tensor([1, 1, 4])).sum().backward()
    assert table.grad is not None
    torch.testing.assert_close(table.grad[:, 0], torch.tensor([0.0, 2, 0, 0, 1]))
