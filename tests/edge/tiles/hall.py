"""A hall of two tiles as points in cells, with what may go wrong at their border: waves, a ball, layers, a hole."""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Bools, Floats
from capture2vr.edge.tiles.grid import STEPS, TileGrid

LENGTH, WIDTH = 190.0, 60.0
"""Cells of the hall's floor along X and Z."""
GRID = TileGrid.over(np.zeros(3), np.array([LENGTH, 40.0, WIDTH]), 1.0, side=100)
BORDER = float(GRID.sides[0])
"""X of the border between the tiles (0, 0, 0) and (1, 0, 0), in cells."""
_HOLE, _BALL = 9.0, 11.0
_BALL_AT = np.array([BORDER, 26.0, 30.0])
_UPPER = 6.0  # cells from the floor to the second layer
_NOISE = 0.05


def hall(seed: int = 0) -> Floats:
    """Points (N,3) of the hall, rounded as those of a scene are; about one to a cell."""
    rng = np.random.default_rng(seed)
    x, z = rng.uniform((3, 3), (LENGTH - 3, WIDTH - 3), (int(1.1 * LENGTH * WIDTH), 2)).T
    floor = np.stack([x, _wave(x), z], axis=1)[~in_hole(x, z)]
    x, z = rng.uniform((BORDER - 30, 8), (BORDER + 30, 22), (900, 2)).T
    layer = np.stack([x, _wave(x) + _UPPER, z], axis=1)
    out = rng.normal(size=(1_700, 3))
    ball = _BALL_AT + _BALL * out / np.linalg.norm(out, axis=1, keepdims=True)
    points = np.concatenate([floor, layer, ball])
    points = points + rng.normal(0, _NOISE, points.shape)
    rounded: Floats = np.rint(points * STEPS) / STEPS
    return rounded


def in_hole(x: Floats, z: Floats) -> Bools:
    """Whether places of the floor lie in its hole, which the border runs through."""
    return np.asarray(np.hypot(x - BORDER, z - 47) < _HOLE)


def distance_to_hall(places: Floats) -> Floats:
    """Distance (N,), nearly, of places (N,3) from the hall's surfaces; the wave is flat enough to measure along Y."""
    x, y, _ = places.T
    ball = np.abs(np.linalg.norm(places - _BALL_AT, axis=1) - _BALL)
    return np.minimum(ball, np.minimum(np.abs(y - _wave(x)), np.abs(y - _wave(x) - _UPPER)))


def _wave(x: Floats) -> Floats:
    return 6 + 2 * np.sin(x / 12)
