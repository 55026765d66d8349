"""Tiles of few or scattered points: a surface where there is one, none where there is not, never an error."""

from __future__ import annotations

import numpy as np
import pytest

from capture2vr.edge.arrays import no_tick
from capture2vr.edge.tiles.grid import STEPS, TileGrid
from capture2vr.edge.tiles.mesh_tile import mesh_tile
from capture2vr.edge.tiles.weld import weld

GRID = TileGrid(np.zeros(3), 1.0, np.array([64, 64, 64]))
TILE = (0, 0, 0)


@pytest.mark.parametrize("noise", [0.0, 0.3])
@pytest.mark.parametrize("count", [0, 1, 16, 17, 25, 60])
@pytest.mark.parametrize("spread", [3.0, 20.0])
def test_few_points_are_no_error(count: int, spread: float, noise: float) -> None:
    places = np.random.default_rng(count).uniform(5, 5 + spread, (count, 3))
    mesh = weld(mesh_tile(no_tick, np.rint(places * STEPS) / STEPS, GRID, TILE, noise), GRID, TILE, [], [])
    assert np.isfinite(mesh.vertices).all()


def test_scattered_points_are_no_surface() -> None:
    """A spacing of fifteen cells: what would lie between them is a guess, and takes hours to extract."""
    places = np.random.default_rng(0).uniform(0, 64, (80, 3))
    assert len(mesh_tile(no_tick, np.rint(places * STEPS) / STEPS, GRID, TILE).faces) == 0


def test_a_sheet_of_points_is_a_surface_of_its_size() -> None:
    x, z = np.random.default_rng(0).uniform(10, 50, (2_000, 2)).T
    cells = np.rint(np.stack([x, np.full_like(x, 20.3), z], axis=1) * STEPS) / STEPS
    mesh = mesh_tile(no_tick, cells, GRID, TILE)
    assert np.ptp(mesh.vertices, axis=0)[[0, 2]] == pytest.approx([40, 40], abs=2)
    assert np.abs(mesh.vertices[:, 1] - 20.3).max() < 0.3
