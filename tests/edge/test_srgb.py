"""sRGB bytes and linear light: every byte survives, and the table of cells gives the nearest byte, as a search does."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.edge.srgb import to_linear, to_srgb

CODES = np.arange(256, dtype=np.uint8)
LIGHT = to_linear(CODES)
LIMITS = ((LIGHT[1:] + LIGHT[:-1]) / 2).astype(np.float32)


def test_every_byte_survives_the_round_trip() -> None:
    assert (to_srgb(LIGHT) == CODES).all()


@given(st.lists(st.floats(-2, 3, width=32), min_size=1, max_size=30))
def test_any_light_becomes_the_nearest_byte(light: list[float]) -> None:
    assert to_srgb(np.array(light)).tolist() == np.searchsorted(LIMITS, np.float32(light)).tolist()


def test_light_at_a_limit_and_beside_it_falls_to_its_own_side() -> None:
    for way in (-np.inf, 0.0, np.inf):
        light = np.nextafter(LIMITS, np.float32(way)) if way else LIMITS
        assert (to_srgb(light) == np.searchsorted(LIMITS, light)).all()
