"""What posed depth images and colours say about a place: surface, free space, or nothing."""

from __future__ import annotations

import numpy as np
import pytest

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.render.free_space import ColouredSurface, ask_views
from capture2vr.edge.render.posed_picture import PosedPicture

SIDE = 64
RED, BLUE = (200, 30, 30), (40, 60, 180)


def picture(depth: float, rgb: Bytes | None = None, eye: tuple[float, float, float] = (0, 0, -1)) -> PosedPicture:
    """A camera at `eye` that looks along +Z, 90 degrees wide, with one depth everywhere (0: unknown)."""
    to_camera = np.eye(4)
    to_camera[:3, 3] = -np.array(eye)
    shown = np.full((SIDE, SIDE, 3), RED, np.uint8) if rgb is None else rgb
    return PosedPicture(
        to_camera,
        np.full(2, 0.5),
        np.full(2, 0.5),
        lambda: shown,
        lambda: np.full((SIDE, SIDE), depth, np.float32),
    )


PLACE, FACING = np.zeros((1, 3)), np.array([[0.0, 0, -1]])


@pytest.mark.parametrize(
    ("depth", "past"),
    [(0.0, 0), (1.0, 0), (1.01, 0), (1.1, 1), (0.5, 0)],
    ids=["unknown", "on", "noise", "past", "before"],
)
def test_a_view_sees_past_a_place_where_its_depth_is_farther(depth: float, past: int) -> None:
    assert ask_views([picture(depth)])(PLACE, FACING).tolist() == [past]
    assert ask_views([picture(depth)] * 3)(PLACE, FACING).tolist() == [3 * past]


def test_a_place_is_not_free_where_as_many_views_see_surface_there() -> None:
    assert ask_views([picture(1.0), picture(3.0)])(PLACE, FACING).tolist() == [0]
    assert ask_views([picture(1.0), picture(3.0), picture(3.0)])(PLACE, FACING).tolist() == [2]


def test_a_grazing_view_and_one_that_does_not_have_the_place_say_nothing() -> None:
    aslant = np.array([[1.0, 0, -0.1]]) / np.linalg.norm([1.0, 0.1])
    assert ask_views([picture(3.0)])(PLACE, aslant).tolist() == [0]
    assert ask_views([picture(3.0, eye=(5, 0, -1))])(PLACE, FACING).tolist() == [0]
    assert ask_views([picture(3.0, eye=(0, 0, 1))])(PLACE, FACING).tolist() == [0], "which is behind the camera"
    assert ask_views([])(PLACE, FACING).tolist() == [0]


def ring_in_front_of_a_wall() -> tuple[PosedPicture, ColouredSurface]:
    """A red ring whose middle shows the blue wall behind it; the picture has no depth."""
    row, column = np.mgrid[:SIDE, :SIDE] + 0.5
    away = np.hypot(row - SIDE / 2, column - SIDE / 2) / (SIDE / 2)  # 1 is 1 unit at the ring's depth
    on = (away > 0.2) & (away < 0.5)
    rgb = np.where(on[..., None], RED, BLUE).astype(np.uint8)
    turn, radius = np.meshgrid(np.linspace(0, 2 * np.pi, 90), np.linspace(0.22, 0.48, 12))
    xyz: Floats = np.stack([radius * np.cos(turn), radius * np.sin(turn), 0 * turn], axis=-1).reshape(-1, 3)
    return picture(0.0, rgb), ColouredSurface(xyz, np.full((len(xyz), 3), RED, np.uint8))


def test_colours_of_the_background_are_free_space_where_it_has_no_depth() -> None:
    shot, surface = ring_in_front_of_a_wall()
    assert ask_views([shot])(PLACE, FACING).tolist() == [0], "depth alone cannot tell"
    assert ask_views([shot], surface)(PLACE, FACING).tolist() == [1]
    on_ring = np.array([[0.35, 0, 0]])
    assert ask_views([shot], surface)(on_ring, FACING).tolist() == [0]


def test_a_hole_that_shows_the_things_own_colour_is_not_free() -> None:
    _, surface = ring_in_front_of_a_wall()
    whole = np.full((SIDE, SIDE, 3), BLUE, np.uint8)
    row, column = np.mgrid[:SIDE, :SIDE] + 0.5
    whole[np.hypot(row - SIDE / 2, column - SIDE / 2) < SIDE / 4] = (190, 40, 36)
    assert ask_views([picture(0.0, whole)], surface)(PLACE, FACING).tolist() == [0]


def test_without_background_in_the_picture_colours_say_nothing() -> None:
    _, surface = ring_in_front_of_a_wall()
    everywhere = np.random.default_rng(0).uniform(-1, 1, (20_000, 3)) * [1, 1, 0]
    full = ColouredSurface(
        np.concatenate([surface.xyz, everywhere]),
        np.concatenate([surface.rgb, np.full((len(everywhere), 3), RED, np.uint8)]),
    )
    assert ask_views([picture(0.0, np.full((SIDE, SIDE, 3), BLUE, np.uint8))], full)(PLACE, FACING).tolist() == [0]
