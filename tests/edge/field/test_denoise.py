"""Noise goes, folds and layers stay, and nobody says which is which."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from capture2vr.edge.arrays import Floats, Tick, no_tick
from capture2vr.edge.errors import Cancelled
from capture2vr.edge.field.denoise import denoise
from capture2vr.edge.field.folds import noise_of
from capture2vr.edge.field.noise import noise_level
from capture2vr.edge.mesh.nouns import Mesh
from tests.support import surfaces

pytestmark = pytest.mark.slow

Maker = Callable[[], Mesh]

CLEAN = [
    (surfaces.hemisphere, 3_000),
    (surfaces.cylinder, 1_000),
    (surfaces.mobius, 3_000),
    (surfaces.corner, 3_000),
    (surfaces.two_sheets, 3_000),
    (surfaces.two_sheets, 1_000),
    (surfaces.pleated_sheet, 3_000),
    (surfaces.pleated_sheet, 1_000),
    (surfaces.pleated_skirt, 1_000),
    (surfaces.grid_with_holes, 2_000),
]
NOISY = [
    (surfaces.sphere, 0.008),
    (surfaces.cylinder, 0.005),
    (surfaces.bumpy_sheet, 0.004),
    (surfaces.smooth_sheet, 0.006),
    (surfaces.corner, 0.005),
    (surfaces.mobius, 0.004),
]


@pytest.mark.parametrize(("surface", "count"), CLEAN)
def test_clean_clouds_are_left_alone(surface: Maker, count: int) -> None:
    points = surfaces.sampled(surface(), count)
    assert _rms(smoothed(points) - points) < 0.02 * _spacing(points)


@pytest.mark.parametrize(("surface", "sigma"), NOISY)
def test_noise_is_taken_off(surface: Maker, sigma: float) -> None:
    points = surfaces.sampled(surface(), 4_000, noise=sigma, seed=0)
    assert _error_left(points, smoothed(points), surface()) < 0.6


@pytest.mark.parametrize(("surface", "sigma"), NOISY)
def test_the_noise_is_measured(surface: Maker, sigma: float) -> None:
    points = surfaces.sampled(surface(), 8_000, noise=sigma, seed=3)
    noise = noise_level(points, cKDTree(points))
    assert np.median(noise.sigma) == pytest.approx(sigma, rel=0.2)
    assert noise.share.mean() > 0.9


def test_noise_finer_than_its_neighbourhoods_is_measured_too() -> None:
    # 30,000 points on a sheet: the 12 nearest lie in a ball as thick as the noise, which alone tells nothing.
    points = surfaces.sampled(surfaces.disk(), 30_000, noise=0.01, seed=0)
    noise = noise_level(points, cKDTree(points))
    assert np.median(noise.sigma) == pytest.approx(0.01, rel=0.25)


def test_large_clouds_share_their_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    # More points than fits: those without one of their own take that of a neighbour.
    monkeypatch.setattr(importlib.import_module("capture2vr.edge.field.denoise"), "ANCHORS", 4_000)
    points = surfaces.sampled(surfaces.disk(), 10_000, noise=0.006, seed=0)
    assert np.abs(smoothed(points)[:, 2]).mean() < 0.3 * np.abs(points[:, 2]).mean()


def test_noisy_layers_stay_apart() -> None:
    points = surfaces.sampled(surfaces.two_sheets(apart=0.06), 6_000, noise=0.006, seed=0)
    assert _error_left(points, smoothed(points), surfaces.two_sheets(apart=0.06)) < 0.5


def test_noise_in_one_half_leaves_the_other_alone() -> None:
    sheet = surfaces.smooth_sheet()
    points = surfaces.sampled(sheet, 12_000)
    noisy = points[:, 0] > 0
    points[noisy] += np.random.default_rng(0).normal(0, 0.005, (int(noisy.sum()), 3))
    smooth = smoothed(points)
    far_clean, far_noisy = points[:, 0] < -0.25, points[:, 0] > 0.1
    assert _rms((smooth - points)[far_clean]) < 2e-4
    assert _error_left(points[far_noisy], smooth[far_noisy], sheet) < 0.5


def test_uneven_density_is_no_noise() -> None:
    points = surfaces.sampled(surfaces.bumpy_sheet(), 20_000)
    kept = np.random.default_rng(0).random(len(points)) < np.where(points[:, 0] > 0, 1.0, 0.08)
    assert _rms(smoothed(points[kept]) - points[kept]) < 1e-4


def test_outliers_neither_hide_the_noise_nor_are_drawn_in() -> None:
    points = surfaces.sampled(surfaces.sphere(), 8_000, noise=0.006, outliers=0.05, seed=0)
    smooth = smoothed(points)
    assert np.linalg.norm(smooth - points, axis=1).max() < 6 * 0.006
    near = np.abs(np.linalg.norm(points, axis=1) - 0.5) < 0.02
    assert _error_left(points[near], smooth[near], surfaces.sphere()) < 0.5


def test_it_moves_with_the_points_and_repeats_itself() -> None:
    points = surfaces.sampled(surfaces.bumpy_sheet(), 3_000, noise=0.006, seed=0)
    rotation = Rotation.from_rotvec([0.3, -1.1, 0.7])
    smooth = smoothed(points)
    np.testing.assert_array_equal(smoothed(points), smooth)
    apart = np.linalg.norm(smoothed(rotation.apply(points)) - rotation.apply(smooth), axis=1)
    assert np.quantile(apart, 0.99) < 1e-6


@pytest.mark.parametrize(
    "points", [np.zeros((3, 3)), np.zeros((500, 3)), np.eye(3)], ids=["three", "one place", "frame"]
)
def test_too_little_to_judge_comes_back_as_it_went(points: Floats) -> None:
    np.testing.assert_array_equal(smoothed(points), points)


def test_it_ticks_to_the_end_and_stops_when_told() -> None:
    points = surfaces.sampled(surfaces.smooth_sheet(), 2_000, noise=0.01)
    seen: list[float] = []
    smoothed(points, seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == 1

    def cancel(fraction: float) -> None:
        raise Cancelled

    with pytest.raises(Cancelled):
        smoothed(points, cancel)


@pytest.mark.data
@pytest.mark.parametrize("file", ["dress/dress-v17k-f34k.obj", "tshirt_folded/tshirt1900-folding-triFolded.obj"])
def test_real_cloth_keeps_its_folds(data_dir: Path, file: str) -> None:
    truth = surfaces.read_unit(data_dir / file)
    points = surfaces.sampled(truth, 10_000)
    assert _rms(smoothed(points) - points) < 0.02 * _spacing(points)


@pytest.mark.data
def test_a_noisy_dress_gets_nearer_to_the_dress(data_dir: Path) -> None:
    truth = surfaces.read_unit(data_dir / "dress" / "dress-v17k-f34k.obj")
    points = surfaces.sampled(truth, 10_000, noise=0.004)
    assert _error_left(points, smoothed(points), truth) < 0.75


def smoothed(points: Floats, tick: Tick = no_tick) -> Floats:
    return denoise(points, noise_of(points), tick)


def _error_left(before: Floats, after: Floats, truth: Mesh) -> float:
    """Return the RMS distance to the surface after smoothing, as a share of that before."""
    dense = cKDTree(surfaces.sampled(truth, 200_000, seed=9))
    gaps = [_rms(dense.query(points)[0][:, None]) for points in (before, after)]
    return gaps[1] / gaps[0]


def _rms(vectors: Floats) -> float:
    return float(np.sqrt(np.square(vectors).sum(axis=1).mean()))


def _spacing(points: Floats) -> float:
    return float(np.median(cKDTree(points).query(points, k=9)[0][:, 8])) * 0.63
