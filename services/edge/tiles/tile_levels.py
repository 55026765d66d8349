"""Levels of detail of a large scene: tiles, and their coarser ancestors, each merged from up to eight children.

Border vertices of a tile or ancestor stay where they are when it is simplified, so that it fits its neighbours of the
same level without a crack; those between its children are free. Everything here is a task of an engine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bools, Floats, Tick, part_of
from capture2vr.edge.asset.target import Target
from capture2vr.edge.capture.nouns import Cloud
from capture2vr.edge.export.glb import to_glb
from capture2vr.edge.export.ktx2 import EncodeKtx2
from capture2vr.edge.mesh.concatenate import concatenate
from capture2vr.edge.mesh.edges import border_edges
from capture2vr.edge.mesh.normals import face_normals
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.edge.mesh.sampling import sample
from capture2vr.edge.mesh.simplify import simplify
from capture2vr.edge.mesh.topology import compact, orient
from capture2vr.edge.render.posed_picture import PosedPicture
from capture2vr.edge.texture.bake_photos import PhotoProjection
from capture2vr.edge.texture.nearest_colour import ColouredPoints, transfer_colours
from capture2vr.edge.texture.texture_mesh import Palette, texture_levels
from capture2vr.edge.tiles.grid import Tile, TileGrid
from capture2vr.edge.tiles.weld import SEAM

_KEPT = 6  # of so many extracted triangles one stays: on flat walls the others show nothing
# Times fewer triangles of an ancestor than of its children together, as many for each as for a tile; but no fewer than
# its largest child has: along a street only two are merged, and after a few levels next to nothing would be left.
_COARSER = 4
_FEWEST = 200  # triangles that are not made fewer
_STEP_M, _STEPS = 1e-4, 16  # of the grid of all tiles' positions: 0.1 mm, or so many to a cell where that is finer
_SAMPLES, _PROBES = 100_000, 5_000  # of a surface, and of the finer one's vertices, for the distance between the two
_HIGH = 0.95  # quantile of those distances that is the error: the highest few are cut corners


@dataclass(frozen=True, slots=True)
class Node:
    """Place of a tile (level 0) or ancestor: `place` in the grid of its level, whose sides are 2^level tiles."""

    level: int
    place: Tile

    @property
    def name(self) -> str:
        """Name in files: "1-2-0-1"."""
        return "-".join(map(str, (self.level, *self.place)))

    @property
    def file(self) -> str:
        """Name of its .glb in the bundle."""
        return f"tile-{self.name}.glb"

    @property
    def parent(self) -> Node:
        """The ancestor one level up."""
        x, y, z = self.place
        return Node(self.level + 1, (x // 2, y // 2, z // 2))


@dataclass(frozen=True, slots=True)
class Level:
    """A tile or ancestor as it is delivered.

    mesh     asset frame; content: its .glb, empty where it has no triangles
    error_m  how far its surface lies from the finest one
    """

    mesh: Mesh
    content: bytes
    error_m: float


def tile_level(
    tick: Tick,
    welded: Mesh,
    points: Cloud,
    pictures: Sequence[PosedPicture],
    grid: TileGrid,
    tile: Tile,
    target: Target,
    encode: EncodeKtx2 | None = None,
) -> Level:
    """Colour and simplify a welded tile, and give it a texture where pictures show it; without any, vertex colours.

    welded    in cells, as are the points of it and its seams
    pictures  that see it, the best first, in the asset frame
    encode    encoder of KTX2 textures for a target that wants them
    """
    node = Node(0, tile)
    mesh = replace(welded, vertices=grid.to_metres(welded.vertices))
    if len(mesh.faces) == 0:
        return _level(mesh, None, grid, target, 0.0)
    xyz, rgb = grid.to_metres(points.xyz), points.rgb
    mesh = mesh if rgb is None else transfer_colours(mesh, xyz, rgb)
    tick(0.2)
    budget = max(len(mesh.faces) // _KEPT, _FEWEST)
    hold = partial(_shared_border, grid, node)
    coarse = simplify(mesh, budget, hold=hold, tick=part_of(tick, 0.2, 0.6))
    if not _drawable(coarse, _step_m(grid)):
        return _level(compact(coarse, np.empty(0, np.int64)), None, grid, target, 0.0)
    if rgb is None or not pictures:
        return _level(coarse, coarse, grid, target, 0.0)
    known = ColouredPoints.of(xyz, rgb)
    photos = PhotoProjection(coarse, pictures, known)
    tick(0.7)
    palette = Palette(known, photos, photos.pixel)
    ktx2 = encode if target.ktx2 else None
    (textured,), _ = texture_levels([coarse], palette, most_px=target.texture_px, encode=ktx2, hold=hold)
    return _level(coarse, textured, grid, target, 0.0)


def ancestor_level(
    tick: Tick, children: Sequence[Mesh], error_m: float, grid: TileGrid, node: Node, target: Target
) -> Level:
    """Merge the meshes of an ancestor's children, and simplify them. error_m: the largest of the children's"""
    fine = orient(joined([mesh for mesh in children if len(mesh.faces)]))
    budget = max(len(fine.faces) // _COARSER, *(len(mesh.faces) for mesh in children), _FEWEST)
    coarse = simplify(fine, budget, hold=partial(_shared_border, grid, node), tick=part_of(tick, 0.2, 0.9))
    error_m += _distance(fine, coarse)
    return _level(coarse, coarse if len(coarse.faces) else None, grid, target, error_m)


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """Put meshes together; border vertices at the same place become one."""
    mesh = concatenate(meshes)
    rim = np.unique(border_edges(mesh.faces))
    _, first, which = np.unique(mesh.vertices[rim], axis=0, return_index=True, return_inverse=True)
    number = np.arange(len(mesh.vertices))
    number[rim] = rim[first[which.ravel()]]
    return replace(mesh, faces=number[mesh.faces])


def _drawable(mesh: Mesh, step_m: float) -> bool:
    """Return whether any triangle still has an area after its positions were rounded; a sliver has none."""
    rounded = np.rint(mesh.vertices / step_m)
    return bool((face_normals(rounded, mesh.faces) != 0).any())


def _step_m(grid: TileGrid) -> float:
    """Step of the grid that all tiles' positions are rounded to."""
    return min(_STEP_M, grid.cell / _STEPS)


def _level(mesh: Mesh, asset: Mesh | TexturedMesh | None, grid: TileGrid, target: Target, error_m: float) -> Level:
    content = b"" if asset is None else to_glb(asset, target.packing, unlit=target.unlit, common_step_m=_step_m(grid))
    return Level(mesh, content, error_m)


def _shared_border(grid: TileGrid, node: Node, mesh: Mesh) -> Bools:
    """Mask (V,) of the border vertices of a mesh in metres that the node's neighbours share."""
    border = np.zeros(len(mesh.vertices), bool)
    border[border_edges(mesh.faces)] = True
    side = grid.sides * 2**node.level
    relative = grid.to_cells(mesh.vertices) - side * np.array(node.place)
    shared: Bools = border & ((relative < SEAM) | (relative > side - SEAM)).any(axis=1)
    return shared


def _distance(fine: Mesh, coarse: Mesh) -> float:
    """Return the simplification error: a high quantile of the distances from finer vertices to the coarser mesh."""
    if not len(coarse.faces):
        return 0.0
    surface = sample(coarse, _SAMPLES, np.random.default_rng(0))
    some = fine.vertices[:: max(1, len(fine.vertices) // _PROBES)]
    nearest = cKDTree(surface.xyz).query(some)[1]
    off: Floats = np.abs(np.einsum("nx,nx->n", some - surface.xyz[nearest], surface.normals[nearest]))
    return float(np.quantile(off, _HIGH))
