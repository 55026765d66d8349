"""Sort all points of a scene into its tiles, on disk: never more than one part of the capture is in memory."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bytes, Floats, Ints, Tick
from capture2vr.edge.capture.nouns import Cloud, CloudParts
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.field.noise import noise_level
from capture2vr.edge.points.voxel_grid import cell_keys, sum_groups
from capture2vr.edge.srgb import to_linear, to_srgb
from capture2vr.edge.tiles.folder import RAW, SceneFolder
from capture2vr.edge.tiles.grid import STEPS, Tile, TileGrid, name_of, neighbours
from capture2vr.sentences.sentence import say

MOST_TILES = 20_000
"""Tiles of a scene: 20 hectares of floor at 1 cm. More of them, and strays far away made the grid what it is."""
_PLACES, _PLACE_POINTS, _FEWEST = 9, 3_000, 100  # where noise is measured, and points of each place
_PART = 1_000_000  # points of a part that are sorted at once: 100 MB
_OFFSET = 1 << 20  # makes the places of tiles positive in their keys


def bounds_of(parts: CloudParts, to_asset: Floats, tick: Tick) -> tuple[Floats, Floats]:
    """Read all points -> their least and greatest coordinates (3,) in the asset frame; to_asset (4,4)."""
    low, high, read = np.full(3, np.inf), np.full(3, -np.inf), 0
    for part in parts.read():
        xyz = _in_asset_frame(part.xyz, to_asset)
        low, high, read = np.minimum(low, xyz.min(axis=0)), np.maximum(high, xyz.max(axis=0)), read + len(xyz)
        tick(min(read / parts.count, 1))
    return low, high


def sort_into_tiles(parts: CloudParts, to_asset: Floats, grid: TileGrid, folder: SceneFolder, tick: Tick) -> None:
    """Write every point to the file of its tile. Raises EdgeError SCENE_TOO_LARGE for more than MOST_TILES."""
    folder.empty_raw()
    counts: Counter[str] = Counter()
    read = 0
    for part in parts.read():
        for start in range(0, len(part.xyz), _PART):
            some = Cloud(part.xyz[start : start + _PART], None if part.rgb is None else part.rgb[start : start + _PART])
            counts.update(_append(some, to_asset, grid, folder))
            read += len(some.xyz)
            tick(min(read / parts.count, 1))
        if len(counts) > MOST_TILES:
            message = say("points_lie_in_more_than", most=MOST_TILES, size=grid.sides.max() * grid.cell)
            raise EdgeError("SCENE_TOO_LARGE", message, hints=(say("remove_stray_points_far_away"),))
    folder.set_tiles(dict(sorted(counts.items())))


def thin_tile(folder: SceneFolder, grid: TileGrid, tile: Tile, *, coloured: bool) -> None:
    """Thin a tile's points to one per cell: the mean of its points, and of their colours in linear light.

    The means are rounded to 1/1024 of a cell and sorted by their cells, so that they are the same whoever reads them.
    """
    path = folder.path("raw", name_of(tile), ".bin")
    keys: Ints = np.empty(0, np.int64)
    sums: Floats = np.empty((0, 7 if coloured else 4))
    size = RAW.itemsize * _PART
    for begin in range(0, path.stat().st_size, size):  # beside a scanner one tile may have a hundred million points
        raw = np.fromfile(path, RAW, _PART, offset=begin)
        own_keys, own_sums = _sum_cells(raw, grid, coloured=coloured)
        keys, sums = sum_groups(np.concatenate([keys, own_keys]), np.concatenate([sums, own_sums]))
    means = sums[:, 1:] / sums[:, :1]
    cells = np.rint(means[:, :3] * STEPS) / STEPS + grid.corner_of(tile)
    rgb = to_srgb(means[:, 3:]) if coloured else np.empty((0, 3), np.uint8)
    folder.save_points(name_of(tile), cells, rgb)


def _sum_cells(raw: NDArray[Any], grid: TileGrid, *, coloured: bool) -> tuple[Ints, Floats]:
    """Sum captured points, records (N,), that lie in one cell: the cells' keys (C,), and (C,4 or 7) the number of their
    points, the sum of their places and of their linear light."""
    xyz = np.clip(raw["xyz"].astype(np.float64), 0, np.nextafter(grid.sides.astype(np.float64), 0))
    light = to_linear(raw["rgb"]) if coloured else np.empty((len(raw), 0))
    columns = np.concatenate([np.ones((len(raw), 1)), xyz, light], axis=1)
    return sum_groups(cell_keys(np.floor(xyz).astype(np.int64)), columns)


def points_around(folder: SceneFolder, grid: TileGrid, tile: Tile, margin: float) -> tuple[Floats, Bytes | None]:
    """Read the thinned points (N,3), in cells, of a tile and `margin` cells around it, and their colours or None.

    They come tile by tile in one order, whichever tile asks.
    """
    cells, rgb = [], []
    for each in sorted([tile, *neighbours(tile)]):
        if folder.path("points", name_of(each)).exists():
            xyz, colours = folder.load_points(name_of(each))
            near = slice(None) if each == tile else grid.within(xyz, tile, margin)
            cells.append(xyz[near])
            rgb.append(colours[near] if len(colours) else colours)
    joined = np.concatenate(rgb)
    return np.concatenate(cells), joined if len(joined) else None


def _append(part: Cloud, to_asset: Floats, grid: TileGrid, folder: SceneFolder) -> dict[str, int]:
    """Append points to the files of their tiles -> how many each got, by the tiles' names."""
    cells = grid.to_cells(_in_asset_frame(part.xyz, to_asset))
    tiles = grid.tiles_of(cells)
    keys = cell_keys(tiles + _OFFSET)
    order = np.argsort(keys, kind="stable")
    starts = np.flatnonzero(np.append(True, np.diff(keys[order]) != 0)) if len(keys) else np.empty(0, np.int64)
    counts = {}
    for start, end in zip(starts, np.append(starts[1:], len(order)), strict=True):
        rows = order[start:end]
        records = np.zeros(len(rows), RAW)
        records["xyz"] = cells[rows] - grid.sides * tiles[rows[0]]
        if part.rgb is not None:
            records["rgb"] = part.rgb[rows]
        name = name_of(tuple(tiles[rows[0]].tolist()))
        with folder.path("raw", name, ".bin").open("ab") as stream:
            records.tofile(stream)
        counts[name] = len(rows)
    return counts


def _in_asset_frame(xyz: Floats, to_asset: Floats) -> Floats:
    placed: Floats = np.asarray(xyz, np.float64) @ to_asset[:3, :3].T + to_asset[:3, 3]
    return placed


def noise_of_tiles(folder: SceneFolder, tiles: Sequence[Tile]) -> float:
    """Measure the noise of a scene's thinned points, in cells: the median over some places of its fullest tiles."""
    counts = folder.tiles or {}
    fullest = sorted(tiles, key=lambda tile: -counts[name_of(tile)])[:_PLACES]
    found = []
    for number, tile in enumerate(fullest):
        cells, _ = folder.load_points(name_of(tile))
        middle = cells[np.random.default_rng(number).integers(len(cells))]
        near = cells[np.argsort(np.square(cells - middle).sum(axis=1), kind="stable")[:_PLACE_POINTS]]
        if len(near) > _FEWEST:
            noise = noise_level(near, cKDTree(near))
            found.append(float(np.median(noise.sigma * noise.share)))
    return float(np.median(found)) if found else 0.0
