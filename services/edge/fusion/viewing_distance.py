"""From how near each part of a scene was seen: what was seen from afar, and from near too, is not needed.

The noise of a depth camera grows with the square of the distance. A wall that is seen through two doors, from 6 m,
comes out 10 cm thick, and nothing tells that its points are wrong, because no camera sees behind it. From within its
room it is exact to millimetres.

A part of the scene is a cell of space together with one of six directions that it is seen from: so the two sides of a
wall are two parts, and a floor seen along a corridor is another than the same floor seen from above.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Bools, Floats, Ints

_CELL_M = 0.08
"""Side of a cell: of a place that nobody saw from near, not even half a hand's breadth is taken for one that somebody
did."""
_REACH = 4
"""Cells before and behind a surface, along the axis that it is seen along, where the noise of a look from afar may
carry its points: three standard deviations at 6 m."""
_TOO_FAR = 2.0
"""Times the least distance from which a part was seen. At twice the distance the noise is four times as large."""
_ALWAYS_M = 2.5
"""Distance up to which everything is used: noise of 1 or 2 cm, which the average of many views removes."""
_BITS = 20  # of a cell's place along an axis, in a key: 40 km to either side
_HALF = 1 << (_BITS - 1)
_PLACES = np.array([1 << 2 * _BITS, 1 << _BITS, 1])
_SIDES = 6


@dataclass(frozen=True, slots=True)
class ViewingDistance:
    """The least distance from which each part of a scene was seen: keys (P,) ascending, least_m (P,)."""

    keys: Ints
    least_m: Floats

    @classmethod
    def of(cls, places: Floats, eyes: Floats) -> ViewingDistance:
        """Build the grid of viewing distances from surface points (N,3) and the positions (N,3) of their cameras."""
        cells, sides = _cells(places), _sides(eyes - places)
        keys, least = _least(_keys(cells, sides), np.linalg.norm(eyes - places, axis=1))
        return cls(*_least(*_spread(keys, least)))

    def is_near(self, places: Floats, eyes: Floats) -> Bools:
        """Return a mask (N,) of the places (N,3) that no camera saw from much nearer than `eyes` (N,3) or (3,)."""
        away = np.linalg.norm(eyes - places, axis=1)
        near: Bools = away <= _ALWAYS_M
        far = np.flatnonzero(~near)
        towards = (eyes - places)[far]
        keys = _keys(_cells(places[far]), _sides(towards))
        at = np.minimum(np.searchsorted(self.keys, keys), len(self.keys) - 1)
        known = self.keys[at] == keys
        near[far] = ~known | (away[far] <= _TOO_FAR * self.least_m[at])
        return near


def _cells(places: Floats) -> Ints:
    cells: Ints = np.clip(np.floor(places / _CELL_M).astype(np.int64) + _HALF, _REACH, 2 * _HALF - 1 - _REACH)
    return cells


def _sides(towards: Floats) -> Ints:
    """The axis (N,) along which a direction (N,3) is longest, 0 to 2, or 3 to 5 where it points backwards."""
    axis = np.abs(towards).argmax(axis=1)
    sides: Ints = axis + 3 * (np.take_along_axis(towards, axis[:, None], axis=1)[:, 0] < 0)
    return sides


def _keys(cells: Ints, sides: Ints) -> Ints:
    """One key for a cell (N,3) and a side (N,)."""
    keys: Ints = (cells * _PLACES).sum(axis=1) * _SIDES + sides
    return keys


def _least(keys: Ints, values: Floats) -> tuple[Ints, Floats]:
    """The distinct keys, ascending, and the least value of each."""
    order = np.lexsort((values, keys))
    first = np.flatnonzero(np.r_[True, np.diff(keys[order]) != 0]) if len(keys) else np.zeros(0, np.int64)
    return keys[order][first], values[order][first]


def _spread(keys: Ints, least: Floats) -> tuple[Ints, Floats]:
    """Give each part's distance to the cells before and behind it as well: noise carries points there."""
    step = _PLACES[keys % _SIDES % 3] * _SIDES
    reach = range(-_REACH, _REACH + 1)
    return np.concatenate([keys + number * step for number in reach]), np.tile(least, len(reach))
