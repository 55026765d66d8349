"""The automatic choice: a pure function with its reasons, and the traits that it looks at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from capture2vr.edge.arrays import Floats
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.points.nouns import Points
from capture2vr.edge.preset_choice import CROWD, FEWEST, NOISY, TILES_POINTS, Traits, choose, traits_of
from tests.support.surfaces import patch, sampled

GARMENT = Traits(points=20_000, spacing=0.01, noise=0.0, extent_m=0.0, gpu=False)


@pytest.mark.parametrize(
    ("change", "preset", "reason"),
    [
        ({}, "standard", "on a CPU"),
        ({"gpu": True}, "fine", "little noise"),
        ({"gpu": True, "stereo": True}, "draft", "photos"),
        ({"stereo": True}, "draft", "photos"),
        ({"stereo": True, "points": CROWD + 1}, "draft", "photos"),
        ({"stereo": True, "extent_m": 5.2}, "scene", "5.2 m"),
        ({"gpu": True, "noise": NOISY + 0.1}, "standard", "noise"),
        ({"gpu": True, "spacing": 0.03}, "standard", "apart"),
        ({"points": FEWEST - 1}, "draft", "too few"),
        ({"points": FEWEST - 1, "gpu": True}, "draft", "too few"),
        ({"extent_m": 5.2}, "scene", "5.2 m"),
        ({"extent_m": 10.4, "points": CROWD + 1}, "scene-tiles", "10.4 m"),
        ({"extent_m": 80.0}, "scene", "80.0 m"),
        ({"points": TILES_POINTS + 1}, "scene-tiles", "more than one mesh"),
        ({"points": TILES_POINTS, "extent_m": 9.9}, "scene", "9.9 m"),
        ({"extent_m": 5.2, "gpu": True}, "scene", "5.2 m"),
        ({"extent_m": 1.8}, "standard", "on a CPU"),
        ({"points": CROWD + 1, "gpu": True}, "scene", "many for one object"),
        ({"points": CROWD + 1}, "scene", "many for one object"),
    ],
)
def test_the_choice_and_its_reason(change: dict[str, float], preset: str, reason: str) -> None:
    choice = choose(replace(GARMENT, **change))
    assert choice.preset == preset
    assert reason in choice.because


def sheet() -> Mesh:
    """A unit square."""
    return patch(lambda u, v: [u, v, 0 * u], 20, 20)


def points(xyz: Floats, **known: object) -> Points:
    given = {"metres_per_unit": 1.0, "scale_confidence": "unknown", "up": None, **known}
    return Points(xyz, None, np.ones(len(xyz), np.float32), **given)


def test_spacing_is_that_of_the_surface_whatever_its_units() -> None:
    xyz = sampled(sheet(), 10_000)
    for scale in (1.0, 1e3):
        traits = traits_of(points(xyz * scale), gpu=False)
        assert traits.spacing == pytest.approx(0.01, rel=0.15)
        assert traits.noise < 0.05
        assert (traits.points, traits.extent_m) == (10_000, 0.0)


@pytest.mark.parametrize("sigma", [0.004, 0.008])
def test_noise_is_told_in_spacings(sigma: float) -> None:
    traits = traits_of(points(sampled(sheet(), 10_000, noise=sigma)), gpu=False)
    assert traits.noise == pytest.approx(sigma / 0.01, rel=0.35)


def test_metres_count_only_where_they_are_known() -> None:
    xyz = sampled(sheet(), 1_000) * 5
    known = traits_of(points(xyz, scale_confidence="metric", metres_per_unit=2.0), gpu=True)
    assert known.extent_m == pytest.approx(10, abs=0.1)
    assert traits_of(points(xyz), gpu=True).extent_m == 0
    by_model = points(xyz, scale_confidence="estimated", metres_per_unit=2.0, scale_by_model=True)
    assert traits_of(by_model, gpu=True).extent_m == 0


@pytest.mark.parametrize("count", [2, 20, 90])
def test_the_smallest_clouds_have_traits_too(count: int) -> None:
    traits = traits_of(points(sampled(sheet(), count)), gpu=False)
    assert np.isfinite(traits.spacing)
    assert choose(traits).preset == "draft"
