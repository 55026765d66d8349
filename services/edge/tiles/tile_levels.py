"""Levels of detail of a large scene: tiles, and their coarser ancestors, each merged from up to eight children.

Border vertices of a tile or ancestor stay where they are when it is simplified, so that it fits its neighbours of the
same level without a crack; those between its children are free.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial

import numpy as np
from scipy.spatial import cKDTree

from services.atomic_write import atomic_write
from services.edge.arrays import Bools, Floats, Tick, no_tick, part_of
from services.edge.asset.target import Target
from services.edge.export.glb import to_glb
from services.edge.export.ktx2 import EncodeKtx2
from services.edge.export.tileset import TilesetNode
from services.edge.mesh.edges import border_edges
from services.edge.mesh.nouns import Mesh, TexturedMesh
from services.edge.mesh.sampling import sample
from services.edge.mesh.simplify import simplify
from services.edge.mesh.topology import orient
from services.edge.texture.bake_photos import PhotoProjection
from services.edge.texture.nearest_colour import ColouredPoints, transfer_colours
from services.edge.texture.texture_mesh import Palette, texture_levels
from services.edge.tiles.folder import SceneFolder
from services.edge.tiles.grid import Tile, TileGrid, name_of
from services.edge.tiles.tile_points import points_around
from services.edge.tiles.tile_views import TileViews
from services.edge.tiles.weld import SEAM

_KEPT = 6  # of so many extracted triangles one stays: on flat walls the others show nothing
_COARSER = 4  # times fewer triangles of an ancestor than of its children together: as many for each as for a tile
_FEWEST = 200  # triangles that are not made fewer
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
class Figures:
    """What is known of a node that is made: triangles, hash of its .glb, box (3,) in the asset frame, and how far its
    surface lies from the finest one."""

    triangles: int
    sha256: str
    low_m: list[float]
    high_m: list[float]
    error_m: float


@dataclass(frozen=True, slots=True)
class LevelMaker:
    """Writes levels of one scene into its folder. encode: encoder of KTX2 textures for a target that wants them."""

    folder: SceneFolder
    grid: TileGrid
    views: TileViews
    target: Target
    encode: EncodeKtx2 | None = None

    def tile(self, tile: Tile, tick: Tick = no_tick) -> None:
        """Make the files of a welded tile: coloured, simplified, with a texture where pictures show it."""
        welded = self.folder.load_mesh("welded", name_of(tile))
        node = Node(0, tile)
        if len(welded.faces) == 0:
            return self._write(node, welded, None, 0.0)
        cells, rgb = points_around(self.folder, self.grid, tile, SEAM)
        mesh = replace(welded, vertices=self.grid.to_metres(welded.vertices))
        xyz = self.grid.to_metres(cells)
        mesh = mesh if rgb is None else transfer_colours(mesh, xyz, rgb)
        tick(0.2)
        budget = max(len(mesh.faces) // _KEPT, _FEWEST)
        coarse = simplify(mesh, budget, hold=partial(self._hold, node), tick=part_of(tick, 0.2, 0.6))
        known = None if rgb is None else ColouredPoints.of(xyz, rgb)
        return self._write(node, coarse, self._textured(coarse, known, tick), 0.0)

    def ancestor(self, node: Node, children: Sequence[Node], tick: Tick = no_tick) -> None:
        """Make the files of an ancestor from those of its children."""
        meshes = [self.folder.load_mesh("level", child.name) for child in children]
        error = max(self.figures(child).error_m for child in children)
        fine = orient(joined([mesh for mesh in meshes if len(mesh.faces)]))
        budget = max(len(fine.faces) // _COARSER, _FEWEST)
        coarse = simplify(fine, budget, hold=partial(self._hold, node), tick=part_of(tick, 0.2, 0.6))
        self._write(node, coarse, coarse if len(coarse.faces) else None, error + _distance(fine, coarse))

    def is_made(self, node: Node) -> bool:
        """Whether all files of a node are there."""
        return self.folder.path("level", node.name, ".json").exists()

    def figures(self, node: Node) -> Figures:
        """The figures of a node that is made."""
        return Figures(**json.loads(self.folder.path("level", node.name, ".json").read_text()))

    def tree(self, node: Node, children: dict[Node, list[Node]]) -> TilesetNode:
        """Return the tree of tiles below a node, as 3D Tiles have it."""
        figures = self.figures(node)
        below = tuple(self.tree(child, children) for child in children.get(node, []))
        low, high = np.array(figures.low_m), np.array(figures.high_m)
        for each in below:
            low, high = np.minimum(low, each.low_m), np.maximum(high, each.high_m)
        return TilesetNode(node.file, figures.sha256, low, high, figures.error_m, below)

    def _textured(self, mesh: Mesh, known: ColouredPoints | None, tick: Tick) -> Mesh | TexturedMesh:
        """Give a tile a texture from the pictures that see it; without any, it keeps its vertex colours."""
        pictures = self.views.that_see(mesh) if known is not None and self.target.texture_px else ()
        if not pictures or known is None:
            return mesh
        photos = PhotoProjection(mesh, pictures, known)
        tick(0.7)
        palette = Palette(known, photos, photos.pixel)
        encode = self.encode if self.target.ktx2 else None
        return texture_levels([mesh], palette, most_px=self.target.texture_px, encode=encode)[0][0]

    def _write(self, node: Node, mesh: Mesh, asset: Mesh | TexturedMesh | None, error_m: float) -> None:
        """Write mesh, .glb and, last, figures: a node with figures has the others too."""
        self.folder.save_mesh("level", node.name, mesh)
        content = (
            b"" if asset is None else to_glb(asset, self.target.packing, unlit=self.target.unlit, common_grid=True)
        )
        with atomic_write(self.folder.path("level", node.name, ".glb"), durable=False) as part:
            part.write_bytes(content)
        corner = self.grid.to_metres(self.grid.sides * 2**node.level * np.array([node.place], np.float64))
        places = mesh.vertices if len(mesh.vertices) else corner
        figures = Figures(
            triangles=len(mesh.faces),
            sha256=hashlib.sha256(content).hexdigest(),
            low_m=places.min(axis=0).tolist(),
            high_m=places.max(axis=0).tolist(),
            error_m=error_m,
        )
        with atomic_write(self.folder.path("level", node.name, ".json"), durable=False) as part:
            part.write_text(json.dumps(asdict(figures)))

    def _hold(self, node: Node, mesh: Mesh) -> Bools:
        """Mask (V,) of the border vertices of a mesh in metres that its neighbours share."""
        border = np.zeros(len(mesh.vertices), bool)
        border[border_edges(mesh.faces)] = True
        side = self.grid.sides * 2**node.level
        relative = self.grid.to_cells(mesh.vertices) - side * np.array(node.place)
        shared: Bools = border & ((relative < SEAM) | (relative > side - SEAM)).any(axis=1)
        return shared


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """Put meshes together; border vertices at the same place become one."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    faces = np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)])
    colours = [mesh.rgb for mesh in meshes if mesh.rgb is not None]
    rgb = np.concatenate(colours) if len(colours) == len(meshes) else None
    rim = np.unique(border_edges(faces))
    _, first, which = np.unique(vertices[rim], axis=0, return_index=True, return_inverse=True)
    number = np.arange(len(vertices))
    number[rim] = rim[first[which.ravel()]]
    return Mesh(vertices, number[faces], rgb)


def _distance(fine: Mesh, coarse: Mesh) -> float:
    """How far the vertices of a finer mesh lie from the planes of a coarser one's nearest places: a high quantile."""
    if not len(coarse.faces):
        return 0.0
    surface = sample(coarse, _SAMPLES, np.random.default_rng(0))
    some = fine.vertices[:: max(1, len(fine.vertices) // _PROBES)]
    nearest = cKDTree(surface.xyz).query(some)[1]
    off: Floats = np.abs(np.einsum("nx,nx->n", some - surface.xyz[nearest], surface.normals[nearest]))
    return float(np.quantile(off, _HIGH))
