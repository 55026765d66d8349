"""Two tiles of one hall, meshed apart and welded, beside the same hall meshed in one piece."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Floats, Ints, no_tick
from capture2vr.edge.mesh.edges import border_edges, edges_of
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.sampling import sample
from capture2vr.edge.tiles.grid import TileGrid
from capture2vr.edge.tiles.mesh_tile import mesh_tile
from capture2vr.edge.tiles.tile_levels import joined
from capture2vr.edge.tiles.weld import strip_of, weld
from tests.edge.tiles.hall import BORDER, GRID, distance_to_hall, hall

LEFT, RIGHT = (0, 0, 0), (1, 0, 0)
NEAR = 4.0  # cells from the border that are looked at
ENTIRE = TileGrid(GRID.origin, GRID.cell, np.array([2, 1, 1]) * GRID.sides)


@dataclass(frozen=True, slots=True)
class Halls:
    """The two sides of a hall, welded, and the hall in one piece."""

    left: Mesh
    right: Mesh
    entire: Mesh

    @property
    def both(self) -> Mesh:
        return joined([self.left, self.right])


@pytest.fixture(scope="module", params=[0.0, 0.1], ids=["as measured", "denoised"])
def halls(request: pytest.FixtureRequest) -> Halls:
    cells = hall()
    left, right = (mesh_tile(no_tick, cells, GRID, tile, request.param) for tile in (LEFT, RIGHT))
    left = weld(left, GRID, LEFT, [RIGHT], [])
    right = weld(right, GRID, RIGHT, [LEFT], [strip_of(left, GRID, RIGHT)])
    return Halls(left, right, mesh_tile(no_tick, cells, ENTIRE, LEFT, request.param))


@pytest.mark.slow
def test_no_crack_runs_along_the_border(halls: Halls) -> None:
    rim, entire_rim = rim_near_border(halls.both), rim_near_border(halls.entire, NEAR + 3)
    away = cKDTree(entire_rim).query(rim)[0]
    assert len(rim) > 10  # the hole, the ends of both layers
    assert away.max() < 1.5, f"the surface ends where the one in one piece does not: {rim[away >= 1.5]}"


@pytest.mark.slow
def test_border_vertices_coincide(halls: Halls) -> None:
    left, right = (mesh.vertices[np.unique(border_edges(mesh.faces))] for mesh in (halls.left, halls.right))
    seam = left[(np.abs(left[:, 0] - BORDER) < NEAR) & (cKDTree(right).query(left)[0] < 0.3)]
    assert len(seam) > 100
    assert {tuple(place) for place in seam} <= {tuple(place) for place in right}


@pytest.mark.slow
def test_no_face_is_there_twice_and_no_edge_has_three(halls: Halls) -> None:
    faces = np.sort(halls.both.faces, axis=1)
    assert len(np.unique(faces, axis=0)) == len(faces)
    assert crowded(halls.both.faces) <= crowded(halls.entire.faces)


@pytest.mark.slow
def test_it_is_as_near_to_the_truth_as_in_one_piece(halls: Halls) -> None:
    tiled, entire = chamfer(halls.both), chamfer(halls.entire)
    assert tiled == pytest.approx(entire, rel=0.01)


@pytest.mark.slow
def test_all_faces_of_the_hall_in_one_piece_are_there(halls: Halls) -> None:
    assert len(halls.both.faces) == pytest.approx(len(halls.entire.faces), rel=0.002)


def test_a_tile_beside_none_keeps_its_mesh() -> None:
    strip = Mesh(np.array([[1.0, 1, 1], [2, 1, 1], [1, 1, 2]]), np.array([[0, 1, 2]]))
    alone = weld(strip, GRID, LEFT, [], [])
    assert np.array_equal(alone.vertices, strip.vertices)
    assert np.array_equal(alone.faces, strip.faces)


def rim_near_border(mesh: Mesh, near: float = NEAR) -> Floats:
    """Middles (B,3) of the border edges near the tiles' border."""
    middles = mesh.vertices[border_edges(mesh.faces)].mean(axis=1)
    return middles[np.abs(middles[:, 0] - BORDER) < near]


def crowded(faces: Ints) -> int:
    return edges_of(faces).crowded_count


def chamfer(mesh: Mesh) -> float:
    """Mean distance of the surface from the truth, and of the points from the surface, in cells."""
    surface = sample(mesh, 100_000, np.random.default_rng(1)).xyz
    return float(distance_to_hall(surface).mean() + cKDTree(surface).query(hall(seed=7))[0].mean())
