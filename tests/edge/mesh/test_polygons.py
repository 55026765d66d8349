"""Polygons become triangles that cover them, and nothing beside them."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.edge.arrays import Floats, Ints
from capture2vr.edge.mesh.polygons import triangulate

ARROW = [(0, 0), (2, -1), (0, 3), (-2, -1)]  # a quad that turns back at its first corner
STEPS = [(0, 0), (4, 0), (4, 1), (1, 1), (1, 3), (0, 3)]


def cut(polygons: list[Floats]) -> tuple[Floats, Ints]:
    """The triangles (T,3,3) of polygons of corners (N,3), and the polygon of each."""
    xyz, sizes = np.concatenate(polygons), np.array([len(each) for each in polygons])
    corners = np.arange(len(xyz))[::-1]  # vertices in another order than the corners
    rows, polygon = triangulate(xyz[::-1], corners, sizes)
    return xyz[::-1][corners[rows]], polygon


def area(polygon: Floats) -> Floats:
    """Vector area (3,) of a polygon of corners (N,3)."""
    twice: Floats = np.cross(polygon, np.roll(polygon, -1, axis=0)).sum(axis=0)
    return twice / 2


def placed(flat: list[tuple[float, float]], turn: Floats) -> Floats:
    laid: Floats = np.pad(np.array(flat, float), ((0, 0), (0, 1))) @ turn[:3, :3].T + turn[:3, 3]
    return laid


@st.composite
def stars(draw: st.DrawFn) -> list[tuple[float, float]]:
    """A polygon around the origin, whose corners lie at any distance from it."""
    count = draw(st.integers(3, 12))
    reach = draw(st.lists(st.floats(0.2, 1.0), min_size=count, max_size=count))
    turn = 2 * np.pi * np.arange(count) / count
    return [(r * float(np.cos(t)), r * float(np.sin(t))) for r, t in zip(reach, turn, strict=True)]


@given(st.lists(stars(), min_size=1, max_size=5), st.integers(0, 2**32 - 1))
def test_triangles_cover_polygons_once_and_are_turned_as_they_are(
    flat: list[list[tuple[float, float]]], seed: int
) -> None:
    turn = trimesh.transformations.random_rotation_matrix(np.random.default_rng(seed).random(3))
    polygons = [placed(each, turn) for each in flat]
    triangles, of = cut(polygons)
    for number, polygon in enumerate(polygons):
        whole = area(polygon)
        parts = np.cross(*(triangles[of == number][:, at] - triangles[of == number][:, 0] for at in (1, 2))) / 2
        np.testing.assert_allclose(parts.sum(axis=0), whole, atol=1e-9)
        along = parts @ whole / np.linalg.norm(whole)
        assert along.min() > -1e-5 * np.linalg.norm(whole)
        assert len(parts) == len(polygon) - 2


@pytest.mark.parametrize("flat", [ARROW, STEPS, ARROW[2:] + ARROW[:2], STEPS[::-1]], ids=str)
def test_a_notch_stays_free(flat: list[tuple[float, float]]) -> None:
    triangles, _ = cut([placed(flat, np.eye(4)), placed([(9, 0), (10, 0), (10, 1)], np.eye(4))])
    mesh = trimesh.Trimesh(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3), process=False)
    assert mesh.area == pytest.approx(abs(area(placed(flat, np.eye(4)))[2]) + 0.5)


def test_a_polygon_of_very_many_corners_costs_no_more_than_its_triangles() -> None:
    turn = np.linspace(0, 2 * np.pi, 300_000, endpoint=False)
    reach = 1 + 0.5 * (np.arange(len(turn)) % 2)
    gear = np.stack([reach * np.cos(turn), reach * np.sin(turn), 0 * turn], axis=1)
    rows, _ = triangulate(gear, np.arange(len(gear)), np.array([len(gear)]))
    assert len(rows) == len(gear) - 2


def test_convex_polygons_are_fans() -> None:
    turn = 2 * np.pi * np.arange(6) / 6
    rows, polygon = triangulate(np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1), np.arange(6), np.array([6]))
    assert rows.tolist() == [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]]
    assert polygon.tolist() == [0, 0, 0, 0]


def test_what_has_no_area_or_no_place_is_cut_somehow() -> None:
    line = np.stack([np.arange(5.0), np.zeros(5), np.zeros(5)], axis=1)
    unknown = np.full((5, 3), np.nan)
    triangles, _ = cut([line, unknown, line[:1].repeat(4, axis=0)])
    assert len(triangles) == 8
    assert [len(each) for each in triangulate(line, np.zeros(0, np.int64), np.zeros(0, np.int64))] == [0, 0]
