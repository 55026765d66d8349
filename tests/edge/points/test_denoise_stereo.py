"""Points of stereo are drawn onto the surface that their ripples hide, and nothing else happens to them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.edge.errors import Cancelled
from capture2vr.edge.points.denoise_stereo import NEIGHBOURS, smooth_stereo_points
from tests.support import surfaces


def rippled(count: int, seed: int = 0) -> np.ndarray:
    """A sheet of side 1 with ripples of 0.004, thirty to the side: about as stereo errs."""
    x, y = np.random.default_rng(seed).random((2, count))
    return np.stack([x, y, 0.004 * np.sin(190 * x) * np.sin(190 * y)], axis=1)


def test_ripples_go_and_the_sheet_stays() -> None:
    before = rippled(20_000)
    after = smooth_stereo_points(before, np.ones(len(before)))
    assert np.abs(after[:, 2]).mean() < 0.4 * np.abs(before[:, 2]).mean()
    inner = (np.abs(before[:, :2] - 0.5) < 0.4).all(axis=1)
    assert np.linalg.norm((after - before)[inner, :2], axis=1).max() < 0.004


def test_a_curved_surface_keeps_its_place() -> None:
    truth = surfaces.sampled(surfaces.pleated_skirt(), 20_000)
    moved = np.linalg.norm(smooth_stereo_points(truth, np.ones(len(truth))) - truth, axis=1)
    assert np.median(moved) < 0.002
    assert moved.max() < 0.03


def test_points_of_little_weight_are_drawn_to_the_others() -> None:
    sheet = rippled(4_000) * [1, 1, 0]
    stray = np.random.default_rng(1).random((400, 3)) * [1, 1, 0.02]
    xyz = np.concatenate([sheet, stray])
    told = smooth_stereo_points(xyz, np.r_[np.ones(len(sheet)), np.full(len(stray), 0.05)])
    untold = smooth_stereo_points(xyz, np.ones(len(xyz)))
    assert np.abs(told[: len(sheet), 2]).mean() < 0.5 * np.abs(untold[: len(sheet), 2]).mean()


@pytest.mark.slow
@given(st.integers(0, 3 * max(NEIGHBOURS)), st.booleans())
def test_few_points_and_copies_of_one_come_back_finite_and_in_order(count: int, copies: bool) -> None:
    xyz = np.zeros((count, 3)) if copies else rippled(count)
    after = smooth_stereo_points(xyz, np.ones(count))
    assert after.shape == xyz.shape
    assert np.isfinite(after).all()
    assert np.allclose(after, xyz, atol=0.5)


def test_it_can_be_cancelled() -> None:
    def cancel(fraction: float) -> None:
        raise Cancelled

    with pytest.raises(Cancelled):
        smooth_stereo_points(rippled(1_000), np.ones(1_000), cancel)
