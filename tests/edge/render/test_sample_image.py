"""Looking up images at positions in shares of their sides."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.edge.render.sample_image import bicubic, bilinear, pixels_at, shrink_to


@pytest.mark.parametrize("rows", [0, 1, 1_024, 40_000])
def test_any_number_of_positions_is_looked_up(rows: int) -> None:
    """OpenCV takes at most 32,767 rows at once."""
    picture = np.arange(12, dtype=np.uint8).reshape(2, 2, 3)
    found = bilinear(picture, np.tile([0.75, 0.25], (rows, 1)))
    assert found.shape == (rows, 3)
    assert found.dtype == np.float32
    assert (found == picture[0, 1]).all()


@given(st.floats(0, 1), st.floats(0, 1))
def test_a_slope_is_interpolated_exactly_but_for_the_edges(x: float, y: float) -> None:
    side = 16
    row, column = (np.mgrid[:side, :side] + 0.5) / side
    image = np.dstack([column, row]).astype(np.float32)
    edge = 0.5 / side
    wanted = np.clip([x, y], edge, 1 - edge)
    assert bilinear(image, np.array([[x, y]]))[0] == pytest.approx(wanted, abs=2e-3)  # OpenCV rounds to 1/32 pixel
    nearest = pixels_at(image, np.array([[x, y]]))[0]
    assert np.abs(nearest - [x, y]).max() <= edge + 1e-6


@given(st.integers(0, 15), st.integers(0, 15), st.sampled_from([bilinear, bicubic]))
def test_a_pixel_s_middle_shows_its_colour(row: int, column: int, sample: Callable[..., np.ndarray]) -> None:
    image = np.random.default_rng(0).random((16, 16, 3)).astype(np.float32)
    assert sample(image, (np.array([[column, row]]) + 0.5) / 16)[0] == pytest.approx(image[row, column], abs=1e-6)


def test_between_pixels_bicubic_loses_less_of_a_wave_than_bilinear() -> None:
    at = np.linspace(0.1, 0.9, 4_000)
    wave = np.sin(2 * np.pi * 60 * (np.arange(240) + 0.5) / 240)  # four pixels long
    image = np.tile(wave, (4, 1))[..., None].astype(np.float32)
    truth = np.sin(2 * np.pi * 60 * at)
    lost = [
        np.abs(sample(image, np.column_stack([at, np.full(len(at), 0.5)]))[:, 0] - truth).mean()
        for sample in (bilinear, bicubic)
    ]
    assert lost[1] < 0.5 * lost[0]


def test_outside_of_the_image_the_nearest_edge_counts() -> None:
    image = np.array([[[1.0], [2.0]], [[3.0], [4.0]]], np.float32)
    at = np.array([[-1.0, -1.0], [2.0, 5.0]])
    assert bilinear(image, at)[:, 0].tolist() == [1, 4]
    assert pixels_at(image[..., 0], at).tolist() == [1, 4]


def test_only_larger_pictures_shrink() -> None:
    picture = np.zeros((60, 80, 3), np.uint8)
    picture[:, :40] = 200
    assert shrink_to(picture, 80) is picture
    small = shrink_to(picture, 20)
    assert small.shape == (15, 20, 3)
    assert small[:, :10].min() == 200
    assert small[:, 10:].max() == 0
