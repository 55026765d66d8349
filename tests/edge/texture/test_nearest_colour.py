"""Colours: sRGB there and back, and points' colours on a mesh."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.srgb import to_linear, to_srgb
from capture2vr.edge.texture.nearest_colour import transfer_colours
from tests.support import surfaces

MESH = surfaces.grid_with_holes()


def test_every_code_survives_linear_light_and_back() -> None:
    codes = np.arange(256, dtype=np.uint8).repeat(3).reshape(-1, 3)
    assert np.array_equal(to_srgb(to_linear(codes)), codes)


def test_light_beyond_the_range_is_clipped() -> None:
    assert to_srgb(np.array([-1.0, 0.0, 7.0])).tolist() == [0, 0, 255]


def test_black_and_white_average_to_half_the_light_not_half_the_code() -> None:
    mesh = Mesh(np.zeros((1, 3)), np.empty((0, 3), np.int64))
    mixed = transfer_colours(mesh, np.array([[1.0, 0, 0], [-1, 0, 0]]), np.array([[0] * 3, [255] * 3], np.uint8))
    assert mixed.rgb is not None
    assert mixed.rgb.tolist() == [[188] * 3]


def test_a_point_on_a_vertex_gives_it_its_colour() -> None:
    rgb = np.random.default_rng(0).integers(0, 256, (len(MESH.vertices), 3), dtype=np.uint8)
    carried = transfer_colours(MESH, MESH.vertices, rgb).rgb
    assert carried is not None
    assert np.abs(carried.astype(int) - rgb).mean() < 2  # the neighbours, one spacing away, weigh under 1 %


@settings(max_examples=30)
@given(st.integers(1, 40), st.integers(0, 2**32 - 1))
def test_carried_colours_stay_between_those_of_the_points(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    rgb = rng.integers(0, 256, (count, 3), dtype=np.uint8)
    carried = transfer_colours(MESH, rng.normal(0, 1, (count, 3)), rgb).rgb
    assert carried is not None
    assert (carried >= rgb.min(axis=0)).all()
    assert (carried <= rgb.max(axis=0)).all()


def test_coinciding_points_are_no_trouble() -> None:
    carried = transfer_colours(MESH, np.repeat(MESH.vertices[:1], 50, axis=0), np.full((50, 3), 77, np.uint8))
    assert carried.rgb is not None
    assert (carried.rgb == 77).all()


def test_points_and_colours_must_match() -> None:
    with pytest.raises(ValueError, match="5 points but 4 colours"):
        transfer_colours(MESH, np.zeros((5, 3)), np.zeros((4, 3), np.uint8))
    with pytest.raises(ValueError, match="at least one"):
        transfer_colours(MESH, np.zeros((0, 3)), np.zeros((0, 3), np.uint8))
