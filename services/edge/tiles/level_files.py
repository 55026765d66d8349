"""The levels of detail of one scene in its folder: what their tasks get, what is stored of them, and their tree."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from capture2vr.edge.asset.target import Target
from capture2vr.edge.capture.nouns import Cloud
from capture2vr.edge.export.ktx2 import EncodeKtx2
from capture2vr.edge.export.tileset import TilesetNode
from capture2vr.edge.tiles.folder import SceneFolder
from capture2vr.edge.tiles.grid import TileGrid, name_of
from capture2vr.edge.tiles.parts import PartWork
from capture2vr.edge.tiles.tile_levels import Level, Node, ancestor_level, tile_level
from capture2vr.edge.tiles.tile_points import points_around
from capture2vr.edge.tiles.tile_views import TileViews
from capture2vr.edge.tiles.weld import SEAM
from capture2vr.process.atomic_write import atomic_write


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
class LevelFiles:
    """Reads and writes levels of one scene. encode: encoder of KTX2 textures for a target that wants them."""

    folder: SceneFolder
    grid: TileGrid
    views: TileViews
    target: Target
    encode: EncodeKtx2 | None = None

    def work_of_tiles(self) -> PartWork[Node, Level]:
        """Make the level of each tile."""
        return PartWork(_name, self.is_made, tile_level, self._inputs_of_tile, self.keep)

    def work_of_ancestors(self, children: Mapping[Node, Sequence[Node]]) -> PartWork[Node, Level]:
        """Make the level of each ancestor, from those of its children."""

        def inputs(node: Node) -> tuple[Any, ...]:
            meshes = [self.folder.load_mesh("level", child.name) for child in children[node]]
            error_m = max(self.figures(child).error_m for child in children[node])
            return meshes, error_m, self.grid, node, self.target

        return PartWork(_name, self.is_made, ancestor_level, inputs, self.keep)

    def is_made(self, node: Node) -> bool:
        """Whether all files of a node are there."""
        return self.folder.path("level", node.name, ".json").exists()

    def figures(self, node: Node) -> Figures:
        """The figures of a node that is made."""
        return Figures(**json.loads(self.folder.path("level", node.name, ".json").read_text()))

    def keep(self, node: Node, made: Level) -> None:
        """Write mesh, .glb and, last, figures: a node with figures has the others too."""
        self.folder.save_mesh("level", node.name, made.mesh)
        with atomic_write(self.folder.path("level", node.name, ".glb"), durable=False) as part:
            part.write_bytes(made.content)
        corner = self.grid.to_metres(self.grid.sides * 2**node.level * np.array([node.place], np.float64))
        places = made.mesh.vertices if len(made.mesh.vertices) else corner
        figures = Figures(
            triangles=len(made.mesh.faces),
            sha256=hashlib.sha256(made.content).hexdigest(),
            low_m=places.min(axis=0).tolist(),
            high_m=places.max(axis=0).tolist(),
            error_m=made.error_m,
        )
        with atomic_write(self.folder.path("level", node.name, ".json"), durable=False) as part:
            part.write_text(json.dumps(asdict(figures)))

    def tree(self, node: Node, children: Mapping[Node, Sequence[Node]]) -> TilesetNode:
        """Return the tree of tiles below a node, as 3D Tiles have it."""
        figures = self.figures(node)
        below = tuple(self.tree(child, children) for child in children.get(node, []))
        low, high = np.array(figures.low_m), np.array(figures.high_m)
        for each in below:
            low, high = np.minimum(low, each.low_m), np.maximum(high, each.high_m)
        return TilesetNode(node.file, figures.sha256, low, high, figures.error_m, below)

    def _inputs_of_tile(self, node: Node) -> tuple[Any, ...]:
        welded = self.folder.load_mesh("welded", name_of(node.place))
        cells, rgb = points_around(self.folder, self.grid, node.place, SEAM)
        shown = replace(welded, vertices=self.grid.to_metres(welded.vertices))
        textured = self.target.texture_px and rgb is not None and len(welded.faces)
        pictures = [each.loaded() for each in self.views.that_see(shown)] if textured else []
        return welded, Cloud(cells, rgb), pictures, self.grid, node.place, self.target, self.encode


def _name(node: Node) -> str:
    return node.name if node.level else name_of(node.place)
