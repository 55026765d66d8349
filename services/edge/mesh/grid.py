"""A sparse grid: corners, edges, faces and cells are int64 keys, so time and memory grow with the surface.

A corner (i,j,k) has the key (i·S + j)·S + k, S = 2²⁰; the neighbour along axis a lies STEP[a] further.
A cell, and an edge or face beside its axis, has the key of its lowest corner.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Floats, Ints

SIDE = 1 << 20  # corners per axis that a key can name: three axes fill 60 of 63 bits
STEP = np.array([SIDE * SIDE, SIDE, 1], np.int64)
PAD = 16  # cells kept free below the points, so that no index of a grown band turns negative

# The grid is shifted off the points' box by fractions of a cell, all different: flat things often lie exactly on their
# box or on its middle plane, where a corner would have distance 0 and a gradient of noise.
SHIFT = np.array([0.37, 0.41, 0.43])

CORNERS = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)], np.int64) @ STEP


@dataclass(frozen=True, slots=True)
class Grid:
    """origin (3,) of corner (0,0,0) and cell side, both in the unit frame."""

    origin: Floats
    side: float

    def cells_of(self, xyz: Floats) -> Ints:
        """Keys (N,) of the cells that contain points (N,3)."""
        index: Ints = np.floor((xyz - self.origin) / self.side).astype(np.int64) @ STEP
        return index

    def xyz_of(self, corners: Ints) -> Floats:
        """Positions (N,3) of corners, by their keys (N,)."""
        index = np.stack([corners // STEP[0], corners // STEP[1] % SIDE, corners % SIDE], axis=1)
        return self.origin + self.side * index


def grid_around(near: Floats, resolution: int) -> Grid:
    """Make a grid of `resolution` cells along the longest side of the points' box. Raises ValueError if that is 0."""
    if resolution < 1:
        raise ValueError(f"a grid needs at least 1 cell along its longest side, not {resolution}")
    low, high = near.min(axis=0), near.max(axis=0)
    side = float((high - low).max()) / resolution
    if not side > 0:
        raise ValueError(f"{len(near)} points without extent: all lie at one place, so no grid fits them")
    return Grid(low - side * (PAD + SHIFT), side)


def find(sorted_keys: Ints, wanted: Ints) -> Ints:
    """Index of each wanted key in the sorted keys; len(sorted_keys) where it is absent."""
    if len(sorted_keys) == 0:
        return np.zeros(len(wanted), np.int64)
    at = np.searchsorted(sorted_keys, wanted)
    found = sorted_keys[np.minimum(at, len(sorted_keys) - 1)] == wanted
    return np.where(found, at, len(sorted_keys))


def without(keys: Ints, sorted_known: Ints) -> Ints:
    """Sorted unique keys that are not among the known ones."""
    keys = sorted_unique(keys)
    new: Ints = keys[find(sorted_known, keys) == len(sorted_known)]
    return new


def sorted_unique(keys: Ints) -> Ints:
    """Sort keys and drop duplicates. `np.unique`, which hashes, takes eight times as long."""
    keys = np.sort(keys)
    distinct: Ints = keys[np.append(True, keys[1:] != keys[:-1])[: len(keys)]]
    return distinct
