"""Write the tileset.json of a large scene: its tiles and levels of detail as OGC 3D Tiles 1.1.

Source: OGC 22-025r4, "3D Tiles Specification 1.1". The contents are the bundle's own .glb files. glTF's Y is up; a
tileset's Z is, and a viewer turns each content by (x, y, z) → (x, -z, y). So the boxes are turned here, the files not.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

import capture2vr
from capture2vr.edge.arrays import Floats
from capture2vr.edge.export.z_up import Z_UP
from capture2vr.storage.bundle import content_name

TILESET_FILE = "tileset.json"

_LEAST_HALF_M = 1e-4  # of a box: a flat wall has none in one direction, and viewers divide by it
_UNSEEN = 2.0  # times the root's error: what is lost where the whole tileset is not drawn


@dataclass(frozen=True, slots=True)
class TilesetNode:
    """A tile of one level of detail, and the finer tiles that replace it.

    file      its content's name, such as "tile-2-0-1.glb"; "" where it has no content
    sha256    of the content
    low_m     (3,) least corner of the content's vertices and of all below it, asset frame: metres, Y up; high_m (3,)
    error_m   how far its surface lies from the finest one, in metres: 0 for a tile that nothing replaces
    """

    file: str
    sha256: str
    low_m: Floats
    high_m: Floats
    error_m: float
    children: tuple[TilesetNode, ...] = ()

    @property
    def name(self) -> str:
        """Name of the content in the bundle: with its hash, as in the store, so that tileset.json finds it anywhere."""
        return content_name(self.file, self.sha256) if self.file else ""

    def __iter__(self) -> Iterator[TilesetNode]:
        """This tile and all below it, the coarsest first."""
        yield self
        for child in self.children:
            yield from child


def tileset_json(root: TilesetNode, to_earth: Floats | None = None) -> bytes:
    """Write a tree of tiles as tileset.json, which lies beside the contents.

    to_earth  (4,4) from the asset frame to geocentric coordinates (ECEF) in metres; None: the place is unknown

    Raises ValueError where a tile's box leaves its parent's, or its error exceeds its parent's: a viewer that trusts
    the parent would never draw it.
    """
    for tile in root:
        _check_children(tile)
    document: dict[str, Any] = {
        "asset": {"version": "1.1", "generator": f"capture2vr {capture2vr.__version__}"},
        "geometricError": _UNSEEN * max(root.error_m, float(np.linalg.norm(root.high_m - root.low_m)) / 100),
        "root": {"refine": "REPLACE", **_tile(root)},
    }
    if to_earth is not None:
        turned = to_earth.copy()
        turned[:3, :3] = to_earth[:3, :3] @ Z_UP.T
        document["root"]["transform"] = turned.T.ravel().tolist()  # column by column
    return json.dumps(document, separators=(",", ":"), sort_keys=True).encode()


def _tile(node: TilesetNode) -> dict[str, Any]:
    tile: dict[str, Any] = {"boundingVolume": {"box": _box(node.low_m, node.high_m)}, "geometricError": node.error_m}
    if node.file:
        tile["content"] = {"uri": node.name}
    if node.children:
        tile["children"] = [_tile(child) for child in node.children]
    return tile


def _box(low_m: Floats, high_m: Floats) -> list[float]:
    """Box of 3D Tiles, Z up: the centre, and the half axes X, Y and Z."""
    x, y, z = (float(value) for value in (low_m + high_m) / 2)
    width, height, depth = (max(float(value), _LEAST_HALF_M) for value in (high_m - low_m) / 2)
    return [round(value, 6) for value in (x, -z, y, width, 0, 0, 0, depth, 0, 0, 0, height)]


def _check_children(tile: TilesetNode) -> None:
    for child in tile.children:
        name = child.file or "a tile without content"
        if np.any(child.low_m < tile.low_m) or np.any(child.high_m > tile.high_m):
            raise ValueError(f"{name}: its box leaves that of {tile.file or 'its parent'}")
        if child.error_m > tile.error_m:
            raise ValueError(f"{name}: its error of {child.error_m} m exceeds the {tile.error_m} m of its parent")
