"""One grid of cells over a large scene, and the tiles that it is cut into: every cell belongs to exactly one tile.

Two frames: the *asset* frame (metres, Y up), and *cells*: the same, from the grid's origin in units of a cell's side.
Points are rounded to 1/1024 of a cell. So their places relative to any tile's corner are exact in float32, and two
tiles that see the same points compute the same field, to the last bit, where they meet.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from capture2vr.edge.arrays import Bools, Floats, Ints
from capture2vr.edge.mesh.grid import PAD, Grid

SIDE = 256
"""Cells along a side of a tile, about: 2.56 m at 1 cm hold some 400,000 points of a furnished room with their halo, and
take 1 GB."""
HALO = 36
"""Cells around a tile whose points its field sees: fields reach 13 spacings, over three rounds of neighbours, and
denoising 10 at most."""
RING = 20
"""Cells around a tile that its mesh covers before it is cut: cleaning reaches 12 spacings, smoothing ten edges."""
STEPS = 1024
"""Parts of a cell that points are rounded to."""
UNIT = 512.0
"""Cells per unit of the local frame of a tile, in which its field is fitted: a power of two keeps places exact."""

_EVEN = 8  # what a side is a multiple of, for the grids that the extraction caches
_WIDEST = 1.25  # of SIDE: how much wider a tile may be, so that no sliver is left over at the end
_MARGIN = (HALO // PAD + 2) * PAD  # cells below a tile's corner that its own grid may number
_SHIFTS = range(0, 9 * _EVEN, _EVEN)  # cells by which the first tile may begin before the scene
_BESIDE = 3.0  # cells from a border within which a wall would be cut to shreds by it
_RIM = 2.5  # cells between the scene's box and the grid's ends
_SHIFT = np.array([379, 420, 440]) / STEPS  # of the grid's corners, for the reason of `mesh.grid.SHIFT`

Tile = tuple[int, int, int]
"""Place of a tile in the grid of tiles, along X, Y and Z."""


_NOWHERE = np.empty((0, 3))


@dataclass(frozen=True, slots=True)
class TileGrid:
    """The grid of a scene: origin (3,) of cell (0,0,0) in the asset frame, the cells' side in metres, and how many of
    them lie along each side (3,) of a tile."""

    origin: Floats
    cell: float
    sides: Ints

    @classmethod
    def over(cls, low: Floats, high: Floats, cell: float, side: int = SIDE, some: Floats = _NOWHERE) -> TileGrid:
        """The grid of a box in metres, whose tiles have about `side` cells along each side, and none a sliver.

        some  (N,3) places of the scene: borders lie where few of them are, not along walls and floors
        """
        extent = np.ceil((high - low) / cell) + 2 * _RIM
        cells = (some - low) / cell + _RIM
        cuts = [_cut_axis(float(extent[axis]), side, cells[:, axis]) for axis in range(3)]
        shifts, sides = np.array(cuts, np.int64).T
        return cls(low - (_RIM + shifts) * cell, cell, sides)

    def to_cells(self, xyz_m: Floats) -> Floats:
        """Transform places (N,3) from the asset frame to cells."""
        cells: Floats = (xyz_m - self.origin) / self.cell
        return cells

    def to_metres(self, cells: Floats) -> Floats:
        """Transform places (N,3) from cells to the asset frame."""
        xyz_m: Floats = cells * self.cell + self.origin
        return xyz_m

    def tiles_of(self, cells: Floats) -> Ints:
        """Tiles (N,3) that places (N,3) in cells lie in."""
        tiles: Ints = np.floor(cells / self.sides).astype(np.int64)
        return tiles

    def corner_of(self, tile: Tile) -> Floats:
        """Lowest corner (3,) of a tile, in cells."""
        corner: Floats = np.asarray(tile, np.float64) * self.sides.astype(np.float64)
        return corner

    def within(self, cells: Floats, tile: Tile, margin: float) -> Bools:
        """Mask (N,) of places in a tile widened by `margin` cells on all sides."""
        relative = cells - self.corner_of(tile)
        return np.asarray(((relative >= -margin) & (relative < self.sides + margin)).all(axis=1))

    def keepers_of(self, places: Floats, filled: Sequence[Tile]) -> Ints:
        """Number (N,) of the tile in a list that each of these places (N,3) belongs to: the nearest, first of equals.

        For a place in a tile of the list, that is its own. A surface that reaches into a tile without points belongs to
        the tile beside it.
        """
        away = [np.maximum(np.abs(places - self.corner_of(each) - self.sides / 2) - self.sides / 2, 0).max(axis=1)
                for each in filled]  # fmt: skip
        keepers: Ints = np.argmin(np.stack(away), axis=0)
        return keepers


def _cut_axis(extent: float, side: int, places: Floats) -> tuple[int, int]:
    """Cut an axis of so many cells into tiles: cells that the first begins before it, and cells of each.

    Of several ways the one with the fewest of the places (N,) beside the inner borders is chosen.
    """
    count = int(np.ceil(extent / (_WIDEST * side)))
    places = np.sort(places)
    best, fewest = (0, 0), np.inf
    for shift in _SHIFTS if count > 1 else (0,):
        wide = _EVEN * int(np.ceil((extent + shift) / count / _EVEN))
        borders = wide * np.arange(1, count) - shift
        before, after = np.searchsorted(places, borders - _BESIDE, "right"), np.searchsorted(places, borders + _BESIDE)
        beside = float((after - before).sum())
        if beside < fewest:
            best, fewest = (shift, wide), beside
    return best


def neighbours(tile: Tile) -> Iterator[Tile]:
    """The 26 tiles around a tile."""
    for step in product((-1, 0, 1), repeat=3):
        if any(step):
            yield (tile[0] + step[0], tile[1] + step[1], tile[2] + step[2])


def name_of(tile: Tile) -> str:
    """Name of a tile in files and messages: "2-0-1"."""
    return "-".join(map(str, tile))


def tile_of(name: str) -> Tile:
    """The tile of a name."""
    x, y, z = map(int, name.split("-"))
    return (x, y, z)


def local_grid() -> Grid:
    """The cells around a tile in its local frame: those of all tiles are parts of one grid."""
    return Grid(-(_MARGIN + _SHIFT) / UNIT, 1 / UNIT)
