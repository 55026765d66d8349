"""The few hundred points that stand for a thing until its mesh is there."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from capture2vr.edge.points.anchor_points import cluster_anchors
from tests.support import surfaces


@given(st.integers(1, 3000), st.booleans(), st.integers(0, 99))
def test_they_are_few_finite_and_inside(count: int, coloured: bool, seed: int) -> None:
    rng = np.random.default_rng(seed)
    xyz, rgb = rng.random((count, 3)), rng.integers(0, 255, (count, 3)).astype(np.uint8)
    centres, colours = cluster_anchors(xyz, rgb if coloured else None)
    assert len(centres) == len(colours) == min(count, 512)
    assert ((centres >= xyz.min(axis=0) - 1e-9) & (centres <= xyz.max(axis=0) + 1e-9)).all()
    assert colours.dtype == np.uint8


def test_every_part_has_one_near_and_in_its_colour() -> None:
    xyz = surfaces.sampled(surfaces.pleated_skirt(), 30_000)
    rgb = np.where(xyz[:, :1] > 0, [[200, 0, 0]], [[0, 0, 200]]).astype(np.uint8)
    centres, colours = cluster_anchors(xyz, rgb)
    gap, _ = cKDTree(centres).query(xyz)
    drawn, _ = cKDTree(xyz[:: len(xyz) // 512][:512]).query(xyz)
    assert np.square(gap).mean() < 0.7 * np.square(drawn).mean()  # better than points drawn at random
    assert ((colours[:, 0] > 0) == (centres[:, 0] > 0)).mean() > 0.97


def test_copies_of_one_point() -> None:
    centres, _ = cluster_anchors(np.ones((2_000, 3)), None)
    assert np.allclose(centres, 1)
