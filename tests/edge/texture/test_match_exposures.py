"""Gains of photos: exact where photos differ by gains alone, robust to highlights, at the points' overall colour."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.edge.arrays import Floats
from capture2vr.edge.texture.match_exposures import match_exposures

PLACES, PHOTOS = 2_000, 8


def around(rng: np.random.Generator, see: int = 3) -> tuple[Floats, Floats]:
    """Light (P,3) of places on a ring, and how well each photo around it sees them (P,N): those before it."""
    place = np.arange(PLACES) * PHOTOS // PLACES
    away = (place[:, None] - np.arange(PHOTOS)) % PHOTOS
    return rng.uniform(0.1, 0.4, (PLACES, 3)), np.where(away < see, 1.0, 0.0)


def seen_with(gains: Floats, light: Floats, quality: Floats) -> Floats:
    return light[:, None] / gains * (quality > 0)[..., None]


@pytest.mark.slow
@given(st.integers(0, 10_000))
def test_photos_that_differ_by_gains_alone_get_these(seed: int) -> None:
    rng = np.random.default_rng(seed)
    light, quality = around(rng)
    gains = np.exp(rng.uniform(-0.5, 0.5, (PHOTOS, 3)))
    found = match_exposures(seen_with(gains, light, quality), quality, light)
    np.testing.assert_allclose(found, gains, rtol=1e-3)


def test_photos_of_a_thing_in_one_deep_colour_get_the_gains_of_their_exposure() -> None:
    """Of a red car green and blue are too dark to be compared everywhere."""
    light, quality = around(np.random.default_rng(0))
    light = light * (1, 0.01, 0.02)
    gains = np.linspace(0.7, 1.4, PHOTOS)[:, None] * np.ones(3)
    found = match_exposures(seen_with(gains, light, quality), quality, light)
    np.testing.assert_allclose(found, gains, rtol=1e-3)


def test_photos_agree_where_the_points_have_the_steps_too() -> None:
    """The points of one half were captured brighter: matched to them alone, photos would differ by a factor of 1.5."""
    light, quality = around(np.random.default_rng(0))
    points = light * np.where(np.arange(PLACES) < PLACES // 2, 1.5, 1.0)[:, None]
    found = match_exposures(seen_with(np.ones((PHOTOS, 3)), light, quality), quality, points)
    assert found.max() / found.min() < 1.15
    assert np.exp(np.log(found).mean()) == pytest.approx(np.sqrt(1.5), rel=0.05)


def test_highlights_in_a_photo_do_not_darken_it() -> None:
    rng = np.random.default_rng(0)
    light, quality = around(rng)
    shown = seen_with(np.ones((PHOTOS, 3)), light, quality)
    shown[rng.random(PLACES) < 0.3, 0] *= 2
    found = match_exposures(shown, quality, light)
    np.testing.assert_allclose(found, 1, rtol=0.02)


def test_a_photo_that_shares_nothing_is_matched_to_the_points_and_one_that_sees_nothing_keeps_its_exposure() -> None:
    light, quality = around(np.random.default_rng(0), see=1)
    quality[:, 3] = 0
    gains = np.linspace(0.7, 1.4, PHOTOS)[:, None] * np.ones(3)
    found = match_exposures(seen_with(gains, light, quality), quality, light)
    np.testing.assert_allclose(found, np.where(np.arange(PHOTOS)[:, None] == 3, 1, gains), rtol=1e-3)
    np.testing.assert_array_equal(match_exposures(np.zeros((5, 2, 3)), np.zeros((5, 2)), np.ones((5, 3))), 1)


@pytest.mark.slow
@given(seed=st.integers(0, 10_000), gain=st.floats(0.6, 1.6), noise=st.floats(0, 0.5))
def test_a_single_photo_gets_its_median_gain(seed: int, gain: float, noise: float) -> None:
    """It has nobody to agree with, so its weight against the points must not grow without bound."""
    rng = np.random.default_rng(seed)
    light = rng.uniform(0.15, 0.3, (PLACES, 3))
    shown = light[:, None] / gain * np.exp(noise * rng.standard_normal((PLACES, 1, 3)))
    found = match_exposures(shown.astype(np.float32), np.ones((PLACES, 1), np.float32), light.astype(np.float32))
    np.testing.assert_allclose(found, gain, rtol=0.1)
