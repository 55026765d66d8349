"""Folds and layers too sparsely sampled to look flat anywhere are no noise; what fills whole neighbourhoods is."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Floats
from capture2vr.edge.errors import Cancelled
from capture2vr.edge.field.folds import noise_of
from capture2vr.edge.field.noise import noise_level
from capture2vr.edge.mesh.nouns import Mesh
from tests.support import surfaces

Maker = Callable[[], Mesh]
SHIRT = "tshirt_folded/tshirt1900-folding-triFolded.obj"


@pytest.mark.parametrize(
    ("surface", "count"),
    [
        (surfaces.nested_bowls, 300),
        (surfaces.nested_bowls, 500),
        (surfaces.two_sheets, 300),
        (surfaces.two_sheets, 600),
    ],
)
@pytest.mark.parametrize("seed", [0, 1])
def test_sparse_layers_are_no_noise(surface: Maker, count: int, seed: int) -> None:
    points = surfaces.sampled(surface(), count, seed=seed)
    assert _taken_for_noise(points) > 0  # what the residuals alone say
    assert noise_of(points).share.mean() < 0.05


@pytest.mark.slow
@pytest.mark.parametrize(
    ("surface", "count", "sigma"),
    [
        (surfaces.smooth_sheet, 500, 0.01),
        (surfaces.smooth_sheet, 1_000, 0.02),
        (surfaces.bumpy_sheet, 4_000, 0.012),
        (surfaces.two_sheets, 6_000, 0.008),
        (surfaces.pleated_sheet, 4_000, 0.004),
        (surfaces.cylinder, 4_000, 0.03),
    ],
)
def test_noise_of_any_strength_is_noise(surface: Maker, count: int, sigma: float) -> None:
    noise = noise_of(surfaces.sampled(surface(), count, noise=sigma, seed=2))
    assert noise.share.mean() > 0.9
    assert np.median(noise.sigma) == pytest.approx(sigma, rel=0.3)


def test_each_region_of_a_cloud_is_judged_by_itself() -> None:
    aside = np.array([0.8, 0, 0])
    layers = surfaces.sampled(surfaces.two_sheets(), 500) - aside
    noisy = surfaces.sampled(surfaces.smooth_sheet(), 2_000, noise=0.01) + aside
    share = noise_of(np.concatenate([layers, noisy])).share
    assert share[: len(layers)].mean() < 0.1
    assert share[len(layers) :].mean() > 0.9


@pytest.mark.slow
def test_large_clouds_are_judged_by_some_of_their_regions() -> None:
    points = surfaces.sampled(surfaces.disk(), 20_000, noise=0.004, seed=0)
    noise = noise_of(points)
    assert noise.share.mean() > 0.9
    np.testing.assert_array_equal(noise_of(points).share, noise.share)


@pytest.mark.slow
def test_it_ticks_to_the_end_and_stops_when_told() -> None:
    points = surfaces.sampled(surfaces.smooth_sheet(), 3_000, noise=0.006)
    seen: list[float] = []
    noise_of(points, seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == 1

    def cancel(fraction: float) -> None:
        raise Cancelled

    with pytest.raises(Cancelled):
        noise_of(points, cancel)


@pytest.mark.data
@pytest.mark.parametrize("count", [1_000, 2_000])
def test_a_folded_shirt_of_few_points_keeps_its_layers(data_dir: Path, count: int) -> None:
    points = surfaces.sampled(surfaces.read_unit(data_dir / SHIRT), count, seed=1)
    assert _taken_for_noise(points) > 0.9
    assert noise_of(points).share.mean() < 0.05


def _taken_for_noise(points: Floats) -> float:
    return float(noise_level(points, cKDTree(points)).share.mean())
