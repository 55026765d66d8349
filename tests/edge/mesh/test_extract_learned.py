"""Extraction and cleaning on fields that err as learned ones do: closed forms, spoilt on purpose.

A learned field has a floor above 0, slopes other than 1, gradients that are noise next to the surface, and zeros where
no surface is: past open borders, far away, in specks, in webs between two layers.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.measure import marching_cubes

from capture2vr.edge.arrays import DistanceFn, Floats
from capture2vr.edge.errors import Cancelled
from capture2vr.edge.mesh.band import evaluate, floor_of, walk
from capture2vr.edge.mesh.cached_field import smooth_cells, with_cache
from capture2vr.edge.mesh.clean import clean
from capture2vr.edge.mesh.extract import extract
from capture2vr.edge.mesh.grid import Grid, grid_around
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.sampling import area
from capture2vr.edge.mesh.settle import settle
from tests.support import surfaces
from tests.support.mesh_metrics import chamfer_l1, compare
from tests.support.patience import CANCEL_S

HEMISPHERE = surfaces.hemisphere()
CENTRE = np.array([0, 0, HEMISPHERE.vertices[:, 2].min()])
NEAR = surfaces.sampled(HEMISPHERE, 4_000)
Spoil = Callable[[Floats, Floats, Floats], tuple[Floats, Floats]]


def ball(q: Floats, centre: Floats = CENTRE, radius: float = 0.5) -> tuple[Floats, Floats]:
    """Around the hemisphere's points the whole ball: its other half is an overshoot of half the surface."""
    away = np.linalg.norm(q - centre, axis=1)
    return np.abs(away - radius), (q - centre) / away[:, None] * np.sign(away - radius)[:, None]


def noise(q: Floats, columns: int) -> Floats:
    """(N,columns) in −1…1: a place always hears the same, but nothing of its neighbours."""
    waves = np.sin(q @ np.array([[12.9898], [78.233], [37.719]]) * 97 * np.arange(1, columns + 1)) * 43_758.5
    heard: Floats = 2 * (waves - np.floor(waves)) - 1
    return heard


def turned(f: Floats, g: Floats, q: Floats) -> Floats:
    """Gradients that are half noise on the surface and sound a cell away."""
    g = g + noise(q, 3) * np.exp(-f / 0.003)[:, None]
    unit: Floats = g / np.linalg.norm(g, axis=1, keepdims=True)
    return unit


SPOILT: dict[str, Spoil] = {
    "rounded floor": lambda f, g, q: (np.sqrt(f**2 + 1e-6), g),
    "raised floor": lambda f, g, q: (f + 3e-3, g),
    "too flat": lambda f, g, q: (0.8 * f, 0.8 * g),
    "too steep": lambda f, g, q: (1.25 * f, 1.25 * g),
    "noisy gradient": lambda f, g, q: (f, turned(f, g, q)),
    "floor and noisy gradient": lambda f, g, q: (np.sqrt(f**2 + 1e-6), turned(f, g, q)),
    "noisy distance": lambda f, g, q: (np.abs(f + 1e-3 * noise(q, 1)[:, 0]), g),
}


@pytest.mark.slow
@pytest.mark.parametrize("resolution", [40, 72])
@pytest.mark.parametrize("spoil", SPOILT.values(), ids=SPOILT.keys())
def test_a_spoilt_hemisphere_is_one_sheet_with_one_border_where_it_should_be(spoil: Spoil, resolution: int) -> None:
    mesh = clean(extract(lambda q: spoil(*ball(q), q), NEAR, resolution=resolution), NEAR)
    quality = compare(mesh, HEMISPHERE, 5_000)
    assert (quality.components, quality.boundary_loops, quality.non_manifold_edges) == (1, 1, 0)
    assert quality.area_ratio == pytest.approx(1, abs=0.02)
    # A thirtieth of a cell: a rounded floor of 1e-3 lies outside by as much before it is measured.
    assert np.abs(np.linalg.norm(mesh.vertices - CENTRE, axis=1) - 0.5).mean() < 7e-4


@pytest.mark.parametrize("floor", [1e-3, 3e-3])
def test_a_floor_moves_no_vertex(floor: float) -> None:
    raised = extract(lambda q: SPOILT["raised floor"](ball(q)[0] + floor - 3e-3, ball(q)[1], q), NEAR, resolution=96)
    assert np.abs(np.linalg.norm(raised.vertices - CENTRE, axis=1) - 0.5).max() < 2e-3
    assert np.abs(np.linalg.norm(raised.vertices - CENTRE, axis=1) - 0.5).mean() < 1e-4


def test_specks_beside_the_surface_and_a_far_sheet_do_not_show() -> None:
    rng = np.random.default_rng(5)
    specks = NEAR[rng.integers(0, len(NEAR), 20)] + rng.normal(0, 0.02, (20, 3))

    def distance(q: Floats) -> tuple[Floats, Floats]:
        f, g = ball(q)
        for speck in specks:
            e, h = ball(q, speck, 0.006)
            f, g = np.minimum(e, f), np.where((e < f)[:, None], h, g)
        height = q[:, 2:] - CENTRE[2] - 0.25
        sheet = np.where(f > 0.1, np.abs(height[:, 0]), np.inf)
        return np.minimum(f, sheet), np.where((sheet < f)[:, None], np.sign(height) * [0, 0, 1], g)

    mesh = clean(extract(distance, NEAR, resolution=64), NEAR)
    quality = compare(mesh, HEMISPHERE, 5_000)
    assert (quality.components, quality.non_manifold_edges) == (1, 0)
    assert quality.area_ratio == pytest.approx(1, abs=0.03)
    assert np.quantile(np.abs(np.linalg.norm(mesh.vertices - CENTRE, axis=1) - 0.5), 0.98) < 0.005


def test_a_web_between_two_layers_is_cut_and_the_layers_stay() -> None:
    near = surfaces.sampled(surfaces.two_sheets(0.12), 6_000)
    sheets = surfaces.two_sheets(0.12)
    web = surfaces.patch(lambda u, v: [u, v, 0 * u], 60, 60)
    middle = Mesh(web.vertices * [0.4, 0.4, 1], web.faces)
    both = Mesh(
        np.concatenate([sheets.vertices, middle.vertices]),
        np.concatenate([sheets.faces, middle.faces + len(sheets.vertices)]),
    )
    mesh = clean(both, near)
    assert compare(mesh, sheets, 5_000).components == 2
    assert area(mesh) == pytest.approx(area(sheets), rel=0.06)


@pytest.mark.slow
@pytest.mark.parametrize("make", [surfaces.sphere, surfaces.hemisphere], ids=["sphere", "hemisphere"])
def test_the_double_cover_of_a_level_above_zero_agrees(make: Callable[[], Mesh]) -> None:
    """Marching cubes at f = r wraps the surface on both sides: twice the area, every vertex r away from our mesh."""
    truth, r, cells = make(), 0.03, 48
    near = surfaces.sampled(truth, 4_000)
    centre = CENTRE if make is surfaces.hemisphere else np.zeros(3)

    def distance(q: Floats) -> tuple[Floats, Floats]:
        f, g = ball(q, centre)
        rim = q - centre
        across = np.linalg.norm(rim[:, :2], axis=1)
        off = np.stack([across - 0.5, rim[:, 2]], axis=1)
        away = np.linalg.norm(off, axis=1)
        past = (rim[:, 2] < 0) & (make is surfaces.hemisphere)
        return np.where(past, away, f), g

    mesh = clean(extract(distance, near, resolution=cells), near)
    axis = np.linspace(-0.6, 0.6, 2 * cells)
    places = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    volume = distance(places)[0].reshape((len(axis),) * 3)
    vertices, faces, _, _ = marching_cubes(volume, r, spacing=(axis[1] - axis[0],) * 3)
    cover = Mesh(vertices - 0.6, faces.astype(np.int64))
    quality = compare(cover, cover, 1_000)
    assert quality.components == (2 if make is surfaces.sphere else 1)  # a closed surface has an inside of its own
    assert quality.boundary_loops == 0
    rim = np.pi**2 * r * (make is surfaces.hemisphere)  # half a tube along the border, of length π
    assert area(cover) == pytest.approx(2 * area(mesh) + rim, rel=0.03)
    assert chamfer_l1(cover, mesh, 20_000) == pytest.approx(r, rel=0.1)


@settings(max_examples=20)
@given(seed=st.integers(0, 2**31))
def test_what_is_read_off_smooth_cells_is_the_field(seed: int) -> None:
    rng = np.random.default_rng(seed)
    grid = grid_around(NEAR, 40)
    smooth = smooth_cells(walk(ball, NEAR, grid, 0.0, lambda _: None), grid)
    asked: list[int] = []

    def counting(q: Floats) -> tuple[Floats, Floats]:
        asked.append(len(q))
        return ball(q)

    q = NEAR[rng.integers(0, len(NEAR), 500)] + rng.normal(0, 0.2 * grid.side, (500, 3))
    f, g = evaluate(with_cache(smooth, counting), q, lambda _: None)
    e, h = evaluate(ball, q, lambda _: None)
    assert sum(asked) < 100
    assert np.abs(f - e).max() < 0.04 * grid.side
    assert (np.einsum("nx,nx->n", g, h)[e > 0.04 * grid.side] > 0.95).all()


def test_cells_of_a_crease_a_gap_and_noise_are_not_smooth() -> None:
    def crease(q: Floats) -> tuple[Floats, Floats]:
        return np.abs(np.abs(q[:, 0]) - q[:, 2]) / np.sqrt(2), np.stack(
            [np.sign(q[:, 0]), 0 * q[:, 0], -np.ones(len(q))], axis=1
        ) * np.sign(np.abs(q[:, 0]) - q[:, 2])[:, None] / np.sqrt(2)

    near = np.random.default_rng(0).uniform(-0.5, 0.5, (4_000, 3))
    near[:, 2] = np.abs(near[:, 0])
    grid = grid_around(near, 32)
    cells = smooth_cells(walk(crease, near, grid, 0.0, lambda _: None), grid)
    middle = grid.xyz_of(cells.keys) + grid.side / 2
    assert np.abs(middle[:, 0]).min() > grid.side / 2
    assert len(cells.keys) > 1_000

    noisy = smooth_cells(
        walk(lambda q: SPOILT["noisy gradient"](*ball(q), q), NEAR, Grid(CENTRE - 1, 0.02), 0.0, lambda _: None),
        Grid(CENTRE - 1, 0.02),
    )
    whole = smooth_cells(walk(ball, NEAR, Grid(CENTRE - 1, 0.02), 0.0, lambda _: None), Grid(CENTRE - 1, 0.02))
    assert len(noisy.keys) < 0.7 * len(whole.keys)


def test_fine_detail_of_a_smooth_field_costs_less_than_two_queries_a_vertex() -> None:
    asked: list[int] = []

    def counting(q: Floats) -> tuple[Floats, Floats]:
        asked.append(len(q))
        return ball(q)

    mesh = extract(counting, NEAR, resolution=128)
    assert sum(asked) < 2 * len(mesh.vertices)
    assert np.abs(np.linalg.norm(mesh.vertices - CENTRE, axis=1) - 0.5).max() < 1e-5


def test_vertices_land_between_the_sides_of_a_floor_and_are_pulled_where_the_sides_disagree() -> None:
    vertices = np.random.default_rng(2).uniform(-0.5, 0.5, (48, 3)) * [1, 1, 0] + [0, 0, 0.001]
    quads = np.arange(48).reshape(12, 4)

    def plane(q: Floats) -> tuple[Floats, Floats]:
        return np.abs(q[:, 2]) + 0.004, np.sign(q[:, 2:]) * [0.0, 0, 1]

    def slope(q: Floats) -> tuple[Floats, Floats]:
        return np.full(len(q), 0.004), np.tile([0.0, 0, 1], (len(q), 1))

    landed = settle(plane, plane, vertices, quads, 0.01, 0.004, lambda _: None)
    assert np.abs(landed[:, 2]).max() < 1e-6
    stayed = settle(slope, slope, vertices, quads, 0.01, 0.004, lambda _: None)
    np.testing.assert_allclose(stayed[:, 2], 0.001, atol=1e-9)


def test_the_floor_is_what_the_field_says_at_the_points() -> None:
    assert floor_of(lambda q: SPOILT["raised floor"](*ball(q), q), NEAR) == pytest.approx(3e-3, rel=0.03)
    assert floor_of(ball, NEAR) < 2e-4


def test_a_slow_field_hears_the_tick_often_and_a_fast_one_gets_large_slabs() -> None:
    asked: list[int] = []

    def field(seconds_each: float) -> DistanceFn:
        def distance(q: Floats) -> tuple[Floats, Floats]:
            asked.append(len(q))
            time.sleep(seconds_each * len(q))
            return ball(q)

        return distance

    q = np.random.default_rng(0).uniform(-1, 1, (20_000, 3))
    evaluate(field(2e-5), q, lambda _: None)
    assert max(asked) < 20_000
    asked.clear()
    evaluate(ball_counted(asked), np.tile(q, (20, 1)), lambda _: None)
    assert len(asked) < 60  # slabs that did not grow were 780

    def stop(fraction: float) -> None:
        if fraction > 0:
            raise Cancelled

    began = time.perf_counter()
    with pytest.raises(Cancelled):
        extract(field(1e-4), NEAR, resolution=256, tick=stop)
    assert time.perf_counter() - began < CANCEL_S


def ball_counted(asked: list[int]) -> DistanceFn:
    def distance(q: Floats) -> tuple[Floats, Floats]:
        asked.append(len(q))
        return ball(q)

    return distance
