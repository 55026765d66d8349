"""How a garment hangs on the dress dummy, on tubes of cloth whose room is known: the dummy is inside, and scaled."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from capture2vr.edge.arrays import Floats
from tests.support.garments import DRESS, SKIRT, corners_of, tube
from tests.support.page_scripts import PageScripts

Outline = Sequence[tuple[float, float, float]]
_FIT = """async (cases) => {
    const { fitGarment, measureGarment } = await import('/web/wardrobe/garment-fit.js');
    return cases.map(([corners, hanging]) => fitGarment(measureGarment(corners), hanging));
}"""
_TORSO = "async () => (await import('/web/graphics/dress-dummy.js')).TORSO"
_CAN_HANG = (
    "async (sizes) => { const { canHang } = await import('/web/wardrobe/garment-fit.js'); return sizes.map(canHang); }"
)
BUST_M, WAIST_M = 1.24, 1.04


def fit(scripts: PageScripts, *cases: tuple[Floats, str]) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = scripts.evaluate(_FIT, [[corners.tolist(), hanging] for corners, hanging in cases])
    return found


def scaled(outline: Outline, factor: float) -> Outline:
    return [(factor * y, factor * x, factor * z) for y, x, z in outline]


def some_dress(random: np.random.Generator) -> Outline:
    """A dress of some size and shape, from a child's to a tall person's."""
    size = random.uniform(0.65, 1.05)
    wide = random.uniform(0.9, 1.3)
    return [(size * y * random.uniform(0.99, 1.01), size * wide * x, size * wide * z) for y, x, z in DRESS]


def test_the_dummy_is_inside_the_garment_and_the_hem_above_the_floor(scripts: PageScripts) -> None:
    random = np.random.default_rng(7)
    torso = np.array([[ring["y"], ring["x"], ring["z"]] for ring in scripts.evaluate(_TORSO)])
    outlines = [some_dress(random) for _ in range(20)]
    for outline, found in zip(
        outlines, fit(scripts, *((corners_of(tube(each)), "shoulders") for each in outlines)), strict=True
    ):
        scale, lift = found["shape"]["scale"], found["shape"]["lift"]
        known = np.array(outline)
        assert found["position_m"][1] + known[0, 0] >= 0.02
        for y, half_width, half_depth in torso[(torso[:, 0] <= BUST_M)]:
            height = y * scale["y"] + lift - found["position_m"][1]
            if not known[0, 0] < height < known[-1, 0]:
                continue  # the garment ends above
            room = [np.interp(height, known[:, 0], known[:, side]) for side in (1, 2)]
            assert half_width * scale["x"] < room[0]
            assert half_depth * scale["z"] < room[1]


def test_where_the_garment_was_captured_does_not_matter_nor_does_its_size(scripts: PageScripts) -> None:
    cloth = tube(scaled(DRESS, 0.9)).vertices[tube(DRESS).faces]
    moved = cloth + np.array([0.2, 0.5, -0.3])
    small = 0.7 * cloth
    one, other, child = fit(scripts, *((each.reshape(-1), "shoulders") for each in (cloth, moved, small)))
    assert other["shape"]["scale"] == pytest.approx(one["shape"]["scale"])
    assert np.subtract(other["position_m"], one["position_m"]) == pytest.approx([-0.2, -0.5, 0.3])
    assert child["shape"]["scale"]["x"] == pytest.approx(
        0.7 * one["shape"]["scale"]["x"], rel=0.03
    )  # slices lie elsewhere
    assert child["position_m"][1] == pytest.approx(0.7 * one["position_m"][1], abs=0.01)


@pytest.mark.parametrize("raised", [0.0, 0.15], ids=["hanging", "puffed"])
def test_sleeves_beside_the_body_neither_widen_the_dummy_nor_move_the_garment(
    scripts: PageScripts, raised: float
) -> None:
    dress = tube(DRESS)
    sleeve = tube([(0.5, 0.05, 0.05), (0.95, 0.05, 0.05)])
    beside = [
        dress,
        *(type(sleeve)(sleeve.vertices + np.array([side * 0.24, raised, 0]), sleeve.faces) for side in (-1, 1)),
    ]
    bare, sleeved = fit(
        scripts,
        (corners_of(dress), "shoulders"),
        (np.concatenate([corners_of(part) for part in beside]), "shoulders"),
    )
    assert sleeved["shape"]["scale"] == pytest.approx(bare["shape"]["scale"], rel=0.03)
    assert sleeved["position_m"] == pytest.approx(bare["position_m"], abs=0.02)


def test_a_strapless_gown_hangs_from_the_bust(scripts: PageScripts) -> None:
    gown = [(0.0, 0.3, 0.3), (0.55, 0.17, 0.13), (0.75, 0.13, 0.1), (0.95, 0.16, 0.12), (1.05, 0.16, 0.11)]
    (found,) = fit(scripts, (corners_of(tube(gown)), "shoulders"))
    top = (found["position_m"][1] + 1.05 - found["shape"]["lift"]) / found["shape"]["scale"]["y"]
    assert BUST_M < top < 1.4  # below the shoulders


def test_a_skirt_hangs_from_the_waist_and_trousers_do_too(scripts: PageScripts) -> None:
    leg = tube([(0.0, 0.08, 0.08), (0.75, 0.095, 0.1)])
    hips = tube([(0.75, 0.19, 0.13), (0.95, 0.14, 0.105)])
    legs = [type(leg)(leg.vertices + np.array([side * 0.1, 0, 0]), leg.faces) for side in (-1, 1)]
    trousers = np.concatenate([corners_of(part) for part in (hips, *legs)])
    for found, height in zip(
        fit(scripts, (corners_of(tube(SKIRT)), "waist"), (trousers, "waist")), (0.5, 0.95), strict=True
    ):
        scale, lift = found["shape"]["scale"], found["shape"]["lift"]
        assert found["position_m"][1] + height == pytest.approx(WAIST_M * scale["y"] + lift, abs=0.02)
        assert scale["x"] > 0.9, "the legs say nothing of the waist"


def test_what_is_too_long_for_the_stand_draws_it_out(scripts: PageScripts) -> None:
    gown = [(0.0, 0.4, 0.4), *((y + 0.7, x, z) for y, x, z in DRESS)]
    (found,) = fit(scripts, (corners_of(tube(gown)), "shoulders"))
    assert found["shape"]["lift"] > 0
    assert found["position_m"][1] == pytest.approx(0.03, abs=0.02)


def test_what_lies_folded_or_is_as_large_as_a_car_cannot_hang(scripts: PageScripts) -> None:
    sizes = [
        [0.5, 1.1, 0.3],
        [0.9, 0.65, 0.2],
        [0.3, 0.3, 0.2],
        [0.44, 0.15, 0.33],
        [1.2, 0.3, 0.9],
        [4.2, 1.5, 1.8],
        [0.5, 2.6, 0.5],
    ]
    assert scripts.evaluate(_CAN_HANG, sizes) == [True, True, True, False, False, False, False]
