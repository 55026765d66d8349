"""The grid of a scene: every place in one tile, no slivers, and no border along a wall."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from capture2vr.edge.tiles.grid import SIDE, STEPS, TileGrid, name_of, neighbours, tile_of

LOW, CELL = np.array([-3.0, 0.0, 7.0]), 0.01


@pytest.mark.parametrize("cells", [40, 250, 330, 500, 1_000, 5_000])
def test_tiles_are_alike_and_none_is_a_sliver(cells: int) -> None:
    grid = TileGrid.over(LOW, LOW + cells * CELL, CELL)
    last = grid.tiles_of(grid.to_cells(LOW + cells * CELL))
    assert (grid.sides % 8 == 0).all()
    assert grid.sides.max() <= 1.4 * SIDE
    assert (last * grid.sides < cells).all()
    assert (cells - last * grid.sides >= min(cells, 0.4 * SIDE)).all()


def test_a_border_keeps_away_from_a_wall() -> None:
    wall = LOW + np.random.default_rng(0).uniform((3.0, 0, 0), (3.02, 2.5, 6.0), (5_000, 3))
    floor = LOW + np.random.default_rng(1).uniform((0, 0, 0), (6.0, 0.0, 6.0), (5_000, 3))
    grid = TileGrid.over(LOW, LOW + 6.0, CELL, some=np.concatenate([wall, floor]))
    places = grid.to_cells(wall)[:, 0]
    borders = grid.sides[0] * np.arange(1, 4)
    assert np.abs(places[:, None] - borders).min() > 2


def test_a_street_of_kilometres_takes_no_more_memory() -> None:
    low, high = np.zeros(3), np.array([10_000.0, 20, 20])
    some = np.random.default_rng(4).uniform(low, high, (20_000, 3))
    tracemalloc.start()
    grid = TileGrid.over(low, high, CELL, some=some)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert (grid.sides > 0.4 * SIDE).all()
    assert most < 20e6


def test_there_and_back_again() -> None:
    grid = TileGrid.over(LOW, LOW + 9.0, CELL)
    places = LOW + np.random.default_rng(2).uniform(0, 9, (100, 3))
    assert grid.to_metres(grid.to_cells(places)) == pytest.approx(places, abs=1e-9)
    tiles = grid.tiles_of(grid.to_cells(places))
    assert all(
        grid.within(grid.to_cells(place[None]), tuple(tile), 0)[0] for place, tile in zip(places, tiles, strict=True)
    )


def test_rounded_places_are_exact_beside_any_corner() -> None:
    """So two tiles see the same points, to the last bit, and compute the same field."""
    grid = TileGrid.over(LOW, LOW + 9.0, CELL)
    cells = np.rint(np.random.default_rng(3).uniform(0, 900, (1_000, 3)) * STEPS) / STEPS
    for tile in ((0, 0, 0), (1, 2, 1)):
        relative = cells - grid.corner_of(tile)
        near = np.abs(relative).max(axis=1) < 400
        assert np.array_equal(relative[near].astype(np.float32).astype(np.float64), relative[near])


def test_a_surface_that_leaves_all_tiles_belongs_to_the_nearest() -> None:
    grid = TileGrid.over(LOW, LOW + 9.0, CELL)
    side = float(grid.sides[0])
    places = np.array([[side - 2, 1, 1], [side + 1, 1, 1], [2 * side + 3, 1, 1]])
    assert grid.keepers_of(places, [(0, 0, 0), (2, 0, 0)]).tolist() == [0, 0, 1]


def test_names_and_neighbours() -> None:
    assert tile_of(name_of((12, 0, 7))) == (12, 0, 7)
    around = list(neighbours((1, 1, 1)))
    assert len(set(around)) == 26
    assert around == sorted(around)
