"""Which pictures show a tile: those that look at it, and have it in front."""

from __future__ import annotations

import numpy as np

from services.edge.arrays import Floats
from services.edge.mesh.nouns import Mesh
from services.edge.render.posed_picture import PosedPicture
from services.edge.tiles.tile_views import TileViews

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
