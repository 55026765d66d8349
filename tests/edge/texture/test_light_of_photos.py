"""Inferred points take the light of photos, or of what is around them; measured ones keep theirs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from capture2vr.edge.arrays import Floats, Tick
from capture2vr.edge.texture.light_of_photos import with_light_of_photos
from capture2vr.edge.texture.nearest_colour import ColouredPoints
from capture2vr.edge.texture.texture_mesh import Palette
from tests.support import surfaces

GROUND = surfaces.patch(lambda u, v: [u, v, 0 * u], 20, 20)  # in the unit frame: x and y from -½ to ½, z = 0
XYZ = np.random.default_rng(0).uniform(-0.5, 0.5, (5_000, 3)) * [1, 1, 0]
RED, GREY = np.array([1.0, 0, 0]), np.array([0.2, 0.2, 0.2])


def grey_points(inferred: np.ndarray | None) -> ColouredPoints:
    points = ColouredPoints.of(XYZ, np.full(XYZ.shape, 124, np.uint8), inferred)
    return replace(points, light=np.tile(GREY, (len(XYZ), 1)))


def red_above(places: Floats, normals: Floats, texel: float, tick: Tick) -> tuple[Floats, Floats]:
    """Photos that show red where y > 0, and nothing elsewhere."""
    return np.tile(RED, (len(places), 1)), (places[:, 1] > 0).astype(float)


def test_inferred_points_go_on_from_what_photos_show_of_them() -> None:
    """Points were coloured before exposures were matched: their grey would end at a line beside the photos' red."""
    inferred = XYZ[:, 0] > 0
    made = with_light_of_photos(Palette(grey_points(inferred), red_above, 0.01), GROUND).points.light
    assert made[inferred] == pytest.approx(np.tile(RED, (inferred.sum(), 1)), abs=0.02)
    deep = ~inferred & (XYZ[:, 0] < -0.1)
    assert np.array_equal(made[deep], np.tile(GREY, (deep.sum(), 1)))


def test_a_guess_keeps_its_own_colours_whatever_photos_show_beside_it() -> None:
    inferred = XYZ[:, 0] > 0
    kept = inferred & (XYZ[:, 1] > 0)
    points = replace(grey_points(inferred), kept=kept)
    made = with_light_of_photos(Palette(points, red_above, 0.01), GROUND).points.light
    np.testing.assert_array_equal(made[kept], points.light[kept])
    assert (made[inferred & ~kept] != points.light[inferred & ~kept]).any()
    whole = replace(points, inferred=np.ones(len(XYZ), bool), kept=np.ones(len(XYZ), bool))
    palette = Palette(whole, red_above, 0.01)
    assert with_light_of_photos(palette, GROUND) is palette


def test_stray_measured_points_amid_inferred_ones_take_their_light() -> None:
    stray = np.linalg.norm(XYZ - [0.3, 0.3, 0], axis=1) < 0.03
    made = with_light_of_photos(Palette(grey_points((XYZ[:, 0] > 0) & ~stray), red_above, 0.01), GROUND).points.light
    assert stray.any()
    assert made[stray] == pytest.approx(np.tile(RED, (stray.sum(), 1)), abs=0.02)


@pytest.mark.parametrize("inferred", [None, np.zeros(len(XYZ), bool)])
def test_measured_points_keep_their_light(inferred: np.ndarray | None) -> None:
    palette = Palette(grey_points(inferred), red_above, 0.01)
    assert with_light_of_photos(palette, GROUND) is palette


def test_what_no_photo_shows_keeps_the_light_it_had() -> None:
    def nothing(places: Floats, normals: Floats, texel: float, tick: Tick) -> tuple[Floats, Floats]:
        return np.zeros((len(places), 3)), np.zeros(len(places))

    made = with_light_of_photos(Palette(grey_points(XYZ[:, 0] > 0), nothing, 0.01), GROUND).points.light
    assert made == pytest.approx(np.tile(GREY, (len(XYZ), 1)), abs=1e-6)
