"""The yardstick itself: known distances on closed-form surfaces."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from services.edge.mesh.metrics import area, compare, edge_faces, pieces, sample
from services.edge.mesh.nouns import Mesh
from tests import surfaces

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


def test_half_a_surface_is_precise_and_not_complete() -> None:
    whole = surfaces.disk()
    half = Mesh(whole.vertices, whole.faces[whole.vertices[whole.faces][:, :, 0].mean(1) < 0])
    quality = compare(half, whole, SAMPLES)
    assert quality.area_ratio == pytest.approx(0.5, abs=0.01)
    assert quality.f_010 == pytest.approx(2 / 3, abs=0.02)  # precision 1, recall a half


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
    welded = _welded(mesh())  # type: ignore[operator]
    quality = compare(welded, welded, 1_000)
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
    assert pieces(edge_faces(np.empty((0, 3), np.int64)).vertices) == 0


def test_quality_is_frozen() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        compare(surfaces.disk(), surfaces.disk(), 100).floor = 0.0  # type: ignore[misc]


def _welded(mesh: Mesh) -> Mesh:
    """Vertices at the same place made one, and faces of less than three corners dropped: closes a patch's seams."""
    _, first, same = np.unique(np.round(mesh.vertices, 9), axis=0, return_index=True, return_inverse=True)
    faces = same.reshape(-1)[mesh.faces]
    whole = (faces[:, [0, 1, 2]] != faces[:, [1, 2, 0]]).all(axis=1)
    return Mesh(mesh.vertices[first], faces[whole])
