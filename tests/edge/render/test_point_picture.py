"""Small pictures of point clouds: what is where, in which colour, and what hides what."""

from __future__ import annotations

from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.render.point_picture import point_picture

Z_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
RED, BLUE = (220, 30, 30), (30, 30, 220)


def block(low: Floats, high: Floats, count: int = 8_000) -> Floats:
    return np.random.default_rng(0).uniform(low, high, (count, 3))


def picture(xyz: Floats, rgb: Bytes | None = None, thing: Floats | None = None) -> Bytes:
    content = point_picture(xyz, rgb, Z_UP, xyz if thing is None else thing)
    return np.asarray(Image.open(BytesIO(content)))


def like(shown: Bytes, colour: tuple[int, int, int]) -> Bytes:
    return np.abs(shown.astype(int) - colour).max(axis=2) < 60


def test_up_is_up_and_the_near_hides_the_far() -> None:
    low = block(np.array([-1, -1, 0.0]), np.array([1, 1, 1.0]))
    top = low + np.array([0, 0, 1.0])
    rgb = np.repeat(np.array([RED, BLUE], np.uint8), len(low), axis=0)
    shown = picture(np.concatenate([low, top]), rgb)
    rows_red, rows_blue = (np.nonzero(like(shown, colour))[0] for colour in (RED, BLUE))
    assert rows_blue.mean() + 60 < rows_red.mean()
    behind = low + np.array([0, 1.5, 0])  # the camera looks along +Y of this frame
    both = np.concatenate([low, behind])
    nearest_last, nearest_first = picture(both, rgb, low), picture(both[::-1], rgb[::-1], low)
    assert np.array_equal(like(nearest_last, RED), like(nearest_first, RED)), "the order in the cloud says nothing"
    assert like(nearest_last, RED).sum() > like(nearest_last, BLUE).sum()


def test_without_colours_it_is_grey_and_fills_the_picture() -> None:
    shown = picture(block(np.full(3, -1.0), np.full(3, 1.0)))
    assert shown.shape == (360, 360, 3)
    assert (shown[..., 0] < 180).mean() > 0.3


@pytest.mark.parametrize("far", [5.0, 500.0])
def test_surroundings_do_not_shrink_the_thing(far: float) -> None:
    thing = block(np.full(3, -1.0), np.full(3, 1.0))
    houses = block(np.full(3, -far), np.full(3, far), 50_000)
    rgb = np.array([RED] * len(thing) + [BLUE] * len(houses), np.uint8)
    shown = picture(np.concatenate([thing, houses]), rgb, thing)
    columns = np.nonzero(like(shown, RED).any(axis=0))[0]
    assert np.ptp(columns) > 360 / 4
