"""Which pictures show a tile: those that look at it, and have it in front."""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.render.posed_picture import PosedPicture
from capture2vr.edge.tiles.tile_views import MOST, TileViews

SHEET = Mesh(
    np.array([[x, y, 2.0] for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)]), np.array([[0, 1, 4], [4, 5, 8]])
)
AHEAD, TURNED = np.diag([1.0, 1, 1, 1]), np.diag([-1.0, 1, -1, 1])


def picture(to_camera: Floats, depth_m: float = 0.0, focal: float = 0.4) -> PosedPicture:
    """A picture of 8 x 8 pixels with the same depth everywhere, 0 for unknown."""
    return PosedPicture(
        to_camera=to_camera,
        focal=np.array([focal, focal]),
        middle=np.array([0.5, 0.5]),
        load_rgb=lambda: np.zeros((8, 8, 3), np.uint8),
        load_depth=lambda: np.full((8, 8), depth_m, np.float32),
    )


def test_only_pictures_that_look_at_it_are_chosen() -> None:
    ahead, turned = picture(AHEAD), picture(TURNED)
    assert TileViews([turned, ahead]).that_see(SHEET) == (ahead,)


def test_what_stands_before_it_hides_it() -> None:
    hidden, seen = picture(AHEAD, 1.0), picture(AHEAD, 2.0)
    assert TileViews([hidden, seen]).that_see(SHEET) == (seen,)


def test_the_picture_that_shows_most_comes_first() -> None:
    near, whole = picture(AHEAD, focal=1.2), picture(AHEAD)
    assert TileViews([near, whole]).that_see(SHEET) == (whole, near)


def test_a_scene_without_pictures_has_none() -> None:
    assert TileViews().that_see(SHEET) == ()


def test_pictures_of_all_parts_come_before_more_of_one() -> None:
    """Many pictures of the left half, and one of the right."""
    left, right = (np.eye(4) for _ in range(2))
    left[0, 3], right[0, 3] = 1.2, -1.2
    pictures = [*(picture(left, focal=0.5) for _ in range(20)), picture(right, focal=0.5)]
    assert any(each is pictures[-1] for each in TileViews(pictures).that_see(SHEET)[:2])


def test_of_many_pictures_the_nearest_are_chosen() -> None:
    """A hundred from afar, and one from half as far that shows as much: it comes first."""
    near = np.eye(4)
    near[2, 3] = -0.9
    far, close = [picture(AHEAD, focal=0.2) for _ in range(100)], picture(near, focal=0.2)
    chosen = TileViews([*far, close]).that_see(SHEET)
    assert chosen[0] is close
    assert len(chosen) <= MOST
