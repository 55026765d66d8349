"""Mesh one tile of a large scene: the field of its points and its halo's, extracted on the scene's grid and cleaned.

The mesh covers a ring around the tile too, so that both sides of a border compute the same surface there; every face
belongs to the tile that its middle lies in (`weld.py` joins them).
"""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Floats, Ints, Tick, part_of
from capture2vr.edge.field.denoise import denoise
from capture2vr.edge.field.local import local_field
from capture2vr.edge.field.noise import Noise
from capture2vr.edge.mesh.clean import clean
from capture2vr.edge.mesh.extract import extract_on_grid
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.spacing import point_spacing
from capture2vr.edge.mesh.topology import compact
from capture2vr.edge.tiles.grid import RING, UNIT, Tile, TileGrid, local_grid

HIDDEN = 0.08
"""Cells of noise that the field's patches hide by themselves."""
FEWEST = 16
"""Points of a tile and its ring; fewer are strays, no surface."""
_COARSER = 2  # grids of 2 and 4 cells that the extraction caches: the same number in all tiles
_STRIP = 3  # cells around a tile whose faces its neighbours may ask for
# Fractions of the time at which denoising, the field and the extraction end; the rest is cleaning.
_DENOISE_SHARE, _FIELD_SHARE, _EXTRACT_SHARE = 0.15, 0.45, 0.65
_SPARSE = 6.0  # cells between points from which on they are strays, or the far end of a scan
_AROUND = 300  # points, about the largest neighbourhood of denoising: fewer tell nothing of the noise
_ANCHORED = 6  # one in so many points has a quadric of its own for denoising: the others use their neighbours'
_PRIMES = np.array([73_856_093, 19_349_663, 83_492_791])  # of a spatial hash (M. Teschner et al., 2003)


def mesh_tile(tick: Tick, cells: Floats, grid: TileGrid, tile: Tile, noise: float = 0.0) -> Mesh:
    """Mesh a tile and a strip around it from the points (N,3) of the tile and its halo; all in cells.

    A task of an engine.

    noise  of the scene's points, in cells: the same for all tiles, so that they denoise alike
    """
    corner = grid.corner_of(tile)
    cells = _dense(cells)
    xyz: Floats = (cells - corner) / UNIT
    inside = grid.within(cells, tile, RING)
    if inside.sum() < FEWEST:
        return Mesh(np.empty((0, 3)), np.empty((0, 3), np.int64))
    if noise > HIDDEN and len(xyz) > _AROUND:
        level = Noise(np.full(len(xyz), noise / UNIT), np.ones(len(xyz)))
        xyz = denoise(xyz, level, part_of(tick, 0, _DENOISE_SHARE), anchors=_anchors(cells))
    near = xyz[inside]
    distance = local_field(xyz, tick=part_of(tick, _DENOISE_SHARE, _FIELD_SHARE))
    grown = part_of(tick, _FIELD_SHARE, _EXTRACT_SHARE)
    raw = extract_on_grid(distance, near, local_grid(), coarser=_COARSER, tick=grown)
    del distance
    mesh = clean(raw, near, tick=part_of(tick, _EXTRACT_SHARE, 1))
    vertices = mesh.vertices * UNIT + corner
    middles = vertices[mesh.faces].mean(axis=1)
    return compact(Mesh(vertices, mesh.faces), np.flatnonzero(grid.within(middles, tile, _STRIP)))


def _dense(cells: Floats) -> Floats:
    """The points that lie close enough to others for cells of this size: a surface through sparse ones is guesswork."""
    if len(cells) < FEWEST:
        return cells[:0]
    return cells[point_spacing(cells) < _SPARSE]


def _anchors(cells: Floats) -> Ints:
    """Indices of the points with a quadric of their own: chosen by their cells, so that all tiles choose the same."""
    hashed = np.bitwise_xor.reduce(np.floor(cells).astype(np.int64) * _PRIMES, axis=1)
    return np.flatnonzero(hashed % _ANCHORED == 0)
