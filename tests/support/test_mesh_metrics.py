"""The yardstick itself: known distances on closed-form surfaces."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from capture2vr.edge.arrays import Floats
from capture2vr.edge.certificate import consistency
from capture2vr.edge.mesh.edges import edges_of
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.sampling import area, sample
from capture2vr.edge.mesh.topology import component_count
from tests.support import surfaces
from tests.support.mesh_metrics import boundary_error, compare, sample_border, welded

SAMPLES = 20_000


def test_samples_spread_evenly_over_the_area() -> None:
    # Two triangles, one nine times the other: a tenth of the samples on the small one, their mean at its centroid.
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 0, 0], [8, 0, 0], [5, 3, 0.0]])
    drawn = sample(Mesh(vertices, np.array([[0, 1, 2], [3, 4, 5]])), SAMPLES, np.random.default_rng(0))
    small = drawn.xyz[:, 0] < 2
    assert small.mean() == pytest.approx(0.1, abs=0.01)
    np.testing.assert_allclose(drawn.xyz[small].mean(0), [1 / 3, 1 / 3, 0], atol=0.02)
    np.testing.assert_allclose(drawn.normals, [[0, 0, 1]] * SAMPLES, atol=1e-12)


def test_a_mesh_against_itself_sits_on_the_floor() -> None:
    quality = compare(surfaces.hemisphere(), surfaces.hemisphere(), SAMPLES)
    assert quality.chamfer_l1 == pytest.approx(quality.floor, rel=0.03)
    assert quality.normal_consistency > 0.995
    assert quality.area_ratio == pytest.approx(1)
    assert quality.f_010 > 0.97  # at 20,000 samples; spacing alone puts some farther


def test_a_shifted_sheet_lies_its_shift_away() -> None:
    sheet = surfaces.disk()
    quality = compare(surfaces.moved(sheet, (0, 0, 0.05)), sheet, SAMPLES)
    assert quality.chamfer_l1 == pytest.approx(0.05, rel=0.01)
    assert quality.chamfer_l2 == pytest.approx(2 * 0.05**2, rel=0.02)
    assert quality.f_005 == quality.f_010 == 0


@pytest.mark.slow
def test_half_a_surface_is_precise_and_not_complete() -> None:
    whole = surfaces.disk()
    half = Mesh(whole.vertices, whole.faces[whole.vertices[whole.faces][:, :, 0].mean(1) < 0])
    quality = compare(half, whole, SAMPLES)
    assert quality.area_ratio == pytest.approx(0.5, abs=0.01)
    assert quality.f_010 == pytest.approx(2 / 3, abs=0.02)  # precision 1, recall a half


@pytest.mark.slow
def test_the_same_seed_gives_the_same_figures() -> None:
    mesh, truth = surfaces.smooth_sheet(), surfaces.bumpy_sheet()
    assert compare(mesh, truth, 5_000, seed=3) == compare(mesh, truth, 5_000, seed=3)
    assert compare(mesh, truth, 5_000, seed=3) != compare(mesh, truth, 5_000, seed=4)


@pytest.mark.parametrize(
    ("mesh", "loops", "components"),
    [
        (surfaces.disk, 1, 1),
        (surfaces.cylinder, 2, 1),
        (surfaces.two_sheets, 2, 2),
        (surfaces.grid_with_holes, 10, 1),
        (surfaces.mobius, 1, 1),
        (surfaces.sphere, 0, 1),
    ],
)
def test_borders_and_pieces_are_counted(mesh: object, loops: int, components: int) -> None:
    whole = welded(mesh())  # type: ignore[operator]
    quality = compare(whole, whole, 1_000)
    assert (quality.boundary_loops, quality.components, quality.non_manifold_edges) == (loops, components, 0)


def test_a_fin_makes_one_edge_non_manifold() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1.0]])
    fin = Mesh(vertices, np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]]))
    quality = compare(fin, fin, 1_000)
    assert (quality.edges, quality.non_manifold_edges, quality.boundary_edges) == (7, 1, 6)


def test_areas_of_known_shapes() -> None:
    assert area(surfaces.sphere()) == pytest.approx(np.pi, rel=1e-3)
    assert area(surfaces.disk()) == pytest.approx(np.pi / 4, rel=1e-3)


def test_a_mesh_without_area_is_refused() -> None:
    with pytest.raises(ValueError, match="0 faces"):
        compare(Mesh(np.empty((0, 3)), np.empty((0, 3), np.int64)), surfaces.disk())
    assert component_count(edges_of(np.empty((0, 3), np.int64)).ends) == 0


def test_quality_is_frozen() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        compare(surfaces.disk(), surfaces.disk(), 100).floor = 0.0  # type: ignore[misc]


def test_a_mesh_reaches_the_floor_of_the_f_score_too() -> None:
    quality = compare(surfaces.hemisphere(), surfaces.hemisphere(), SAMPLES)
    assert quality.f_005 == pytest.approx(quality.floor_f_005, abs=0.01)


def test_a_border_is_sampled_evenly_along_its_length() -> None:
    # A triangle of sides 3, 4 and 5: shares of the samples as of the lengths.
    triangle = Mesh(np.array([[0, 0, 0], [3, 0, 0], [0, 4, 0.0]]), np.array([[0, 1, 2]]))
    drawn = sample_border(triangle, SAMPLES, np.random.default_rng(0))
    assert (drawn[:, 1] == 0).mean() == pytest.approx(3 / 12, abs=0.01)
    assert (drawn[:, 0] == 0).mean() == pytest.approx(4 / 12, abs=0.01)


@pytest.mark.slow
def test_the_boundary_error_of_concentric_disks_is_the_difference_of_their_radii() -> None:
    disk = surfaces.disk()
    smaller = Mesh(disk.vertices * 0.8, disk.faces)
    assert boundary_error(smaller, disk) == pytest.approx(0.1, rel=0.01)
    assert boundary_error(disk, smaller) == pytest.approx(0.1, rel=0.01)
    assert boundary_error(disk, disk) < 2e-4  # the borders' own sampling


@pytest.mark.slow
def test_a_torn_hole_shows_in_the_boundary_error_by_its_length_and_distance() -> None:
    disk = surfaces.disk()
    away = np.linalg.norm(disk.vertices[disk.faces].mean(1), axis=1)
    torn = Mesh(disk.vertices, disk.faces[away > 0.1])
    # The hole's border is a fifth as long as the rim and 0.4 from it; the rim itself is found.
    assert boundary_error(torn, disk) == pytest.approx(0.5 * 0.4 * (0.2 / 1.2), rel=0.1)


def test_borders_that_only_one_mesh_has_are_infinitely_wrong() -> None:
    sphere, disk = surfaces.sphere(), surfaces.disk()
    assert boundary_error(sphere, disk) == boundary_error(disk, sphere) == np.inf
    assert boundary_error(sphere, sphere) == 0  # its grid's own seam is no border


def test_welding_closes_seams_and_drops_the_faces_of_a_pole() -> None:
    sphere = surfaces.sphere()
    whole = welded(sphere)
    assert (edges_of(sphere.faces).size == 1).any()
    assert (edges_of(whole.faces).size == 2).all()
    assert len(whole.faces) == len(sphere.faces) - 2 * 192
    assert area(whole) == pytest.approx(area(sphere))


def test_a_true_distance_field_is_consistent_and_a_twisted_one_is_not() -> None:
    queries = np.random.default_rng(0).uniform(-0.5, 0.5, (2_000, 3))
    queries = queries[np.linalg.norm(queries, axis=1) > 0.1]

    def sphere(q: Floats) -> tuple[Floats, Floats]:
        away = np.linalg.norm(q, axis=1, keepdims=True)
        return np.abs(away[:, 0] - 0.4), np.where(away < 0.4, -3, 3) * q / away  # of any length

    def twisted(q: Floats) -> tuple[Floats, Floats]:
        f, g = sphere(q)
        turn = 40 * f  # about z, by an angle that grows with the distance
        x, y = np.cos(turn) * g[:, 0] - np.sin(turn) * g[:, 1], np.sin(turn) * g[:, 0] + np.cos(turn) * g[:, 1]
        return f, np.stack([x, y, g[:, 2]], axis=1)

    assert consistency(sphere, queries) < 1e-6
    assert consistency(twisted, queries) > 0.1


def test_a_field_without_direction_is_wholly_inconsistent() -> None:
    assert consistency(lambda q: (np.zeros(len(q)), np.zeros_like(q)), np.ones((3, 3))) == 1
    with pytest.raises(ValueError, match="queries"):
        consistency(lambda q: (np.zeros(len(q)), q), np.empty((0, 3)))
