"""Reconstruct a large scene tile by tile: time and disk grow with its area, memory is that of one tile.

1. sort    all points into tiles on disk, then thin each tile to a point per cell    (tile_points.py)
2. mesh    every tile with its halo                                                  (mesh_tile.py)
3. weld    each tile to its neighbours                                               (weld.py)
4. level   colour, simplify and pack the tiles, then their ancestors                 (tile_levels.py)

Tiles are meshed, and levels made, one after the other or side by side on an engine    (parts.py)
What is finished is on disk: a run that was killed goes on with the tiles that are missing.
"""

from __future__ import annotations

import hashlib
from collections.abc import Generator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

import capture2vr
from capture2vr.edge.arrays import Floats, Tick, part_of
from capture2vr.edge.asset.target import Target
from capture2vr.edge.capture.nouns import Cloud, CloudParts
from capture2vr.edge.engine.nouns import Engine
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.export.tileset import TILESET_FILE, TilesetNode, tileset_json
from capture2vr.edge.job_resources import CPU_ALONE, JobResources
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.spacing import point_spacing
from capture2vr.edge.points.nouns import Points
from capture2vr.edge.preset import Preset
from capture2vr.edge.preset_choice import ROOM_M
from capture2vr.edge.progress import Bar, Clock, Progress
from capture2vr.edge.render.place_views import posed_picture
from capture2vr.edge.tiles.folder import SceneFolder
from capture2vr.edge.tiles.grid import HALO, SIDE, Tile, TileGrid, name_of, neighbours, tile_of
from capture2vr.edge.tiles.level_files import LevelFiles
from capture2vr.edge.tiles.mesh_tile import mesh_tile
from capture2vr.edge.tiles.parts import PartWork, Span, run_parts
from capture2vr.edge.tiles.tile_levels import Node
from capture2vr.edge.tiles.tile_points import bounds_of, noise_of_tiles, points_around, sort_into_tiles, thin_tile
from capture2vr.edge.tiles.tile_views import TileViews
from capture2vr.edge.tiles.weld import strip_of, weld
from capture2vr.sentences.sentence import say

TILE_STARTS = {"FITTING": 0.0, "EXTRACTING": 0.1, "TEXTURING": 0.75, "PACKING": 0.97, "PUBLISHING": 0.99}
"""Fraction of the pass at which each stage begins: measured on 4 million points of a flat."""
FINEST_M = 0.01
"""Least side of a cell in metres: a hand-held scan of a room is no more exact."""

_MOST_CELLS = 2_000  # along the longest side of a scene whose size in metres is unknown, and of an object
_SOME = 100_000  # points by which borders are chosen
_PROBES = 5_000  # points whose spacing is measured
_TILES_SHARE = 0.9  # of the time of all levels, for that of the tiles


@dataclass(frozen=True, slots=True)
class TiledScene:
    """A scene's tiles and their ancestors, on disk.

    root      the coarsest one, with all others below; files: the contents by their names in the bundle
    mesh      the coarsest one's mesh, asset frame
    grid      of the cells; points: of all tiles, before they are thinned
    to_earth  (4,4) from the asset frame to geocentric coordinates (ECEF) in metres; None: the place is unknown
    """

    root: TilesetNode
    files: Mapping[str, Path]
    mesh: Mesh
    grid: TileGrid
    points: int
    tiles: int
    triangles: int
    levels: int
    to_earth: Floats | None = None

    @property
    def manifest(self) -> dict[str, str | int]:
        """The manifest's entry `tileset`."""
        return {"file": TILESET_FILE, "tiles": self.tiles, "triangles": self.triangles, "levels": self.levels}

    @property
    def document(self) -> bytes:
        """The tileset.json."""
        return tileset_json(self.root, self.to_earth)


@dataclass(frozen=True, slots=True)
class LargeScene:
    """A capture that is made tile by tile: its points, (4,4) from their frame to the asset frame, and for what."""

    points: Points
    to_asset: Floats
    preset: Preset
    target: Target


def reconstruct_tiles(
    scene: LargeScene, folder: Path, clock: Clock, bar: Bar, resources: JobResources = CPU_ALONE, *, side: int = SIDE
) -> Generator[Progress, None, TiledScene]:
    """Mesh all points of a capture tile by tile, and make the levels of detail.

    folder     holds what is finished; the caller removes it once the result is published
    resources  the engine that works at tiles side by side, and the encoder of textures
    side       cells along a side of a tile
    Raises EdgeError TILE_FAILED, which names the tile, SCENE_TOO_LARGE, EXTRACTION_EMPTY, ENGINE_LOST; Cancelled as
    `bar` does.
    """
    points, to_asset, target = scene.points, scene.to_asset, scene.target
    parts = points.whole or CloudParts(len(points), lambda: iter((Cloud(points.xyz, points.rgb),)))
    files = SceneFolder(folder)
    yield bar.begin("FITTING", say("count_points", count=parts.count))
    with clock("FITTING"):
        tick = bar.tick("FITTING")
        low, high = bounds_of(parts, to_asset, part_of(tick, 0, 0.3))
        grid = choose_grid(points, parts.count, to_asset, low, high, scene.preset, side)
        files.begin(_fingerprint(points, parts.count, to_asset, grid, target))
        tiles = _sorted_tiles(parts, points, to_asset, grid, files, tick)
        noise = noise_of_tiles(files, tiles)
    views = TileViews([posed_picture(view, to_asset) for view in points.scene_views or points.texture_views])
    levels = LevelFiles(files, grid, views, target, resources.encode if target.ktx2 else None)
    with resources.engine() if resources.engine else nullcontext() as running:
        yield bar.begin("EXTRACTING", say("tiles_of_size", count=len(tiles), size=grid.sides.max() * grid.cell))
        with clock("EXTRACTING"):
            yield from run_parts(running, tiles, _mesh_work(files, grid, noise), Span(bar, "EXTRACTING"))
            _weld_all(files, grid, tiles, bar.tick("EXTRACTING"))
        with clock("TEXTURING"):
            # The encoder is a program of this machine, which others may not have.
            return (yield from _levels(None if levels.encode else running, levels, tiles, bar))


def choose_grid(
    points: Points, count: int, to_asset: Floats, low: Floats, high: Floats, preset: Preset, side: int = SIDE
) -> TileGrid:
    """Choose the cells of a scene by the spacing of all its points, of which `points` are some, and cut it into tiles.

    low, high (3,) of all points, in the asset frame.

    A room or street of known scale gets none finer than FINEST_M; an object does, which a scanner shows more exactly. A
    resolution that was asked for decides alone.
    """
    longest = float((high - low).max())
    some = points.xyz[np.random.default_rng(0).permutation(len(points))[:_PROBES]]
    spacing = float(np.median(point_spacing(some, cKDTree(points.xyz)))) * points.metres_per_unit
    spacing *= min(len(points) / count, 1.0) ** 0.5
    is_room = points.scale_confidence != "unknown" and longest > ROOM_M
    least = FINEST_M if is_room else longest / _MOST_CELLS
    cell = longest / preset.resolution if preset.resolution else max(spacing / preset.cells_per_spacing, least)
    chosen = points.xyz[:: max(1, len(points) // _SOME)]
    return TileGrid.over(low, high, cell, side, chosen @ to_asset[:3, :3].T + to_asset[:3, 3])


def _fingerprint(points: Points, count: int, to_asset: Floats, grid: TileGrid, target: Target) -> dict[str, object]:
    """What a scene's files depend on: they are made anew where any of it differs."""
    return {
        "version": capture2vr.__version__,
        "points": count,
        "sample": hashlib.sha256(points.xyz.tobytes()).hexdigest(),
        "to_asset": to_asset.tolist(),
        "origin": grid.origin.tolist(),
        "cell": grid.cell,
        "sides": grid.sides.tolist(),
        "target": target.name,
    }


def _sorted_tiles(
    parts: CloudParts, points: Points, to_asset: Floats, grid: TileGrid, files: SceneFolder, tick: Tick
) -> list[Tile]:
    """Sort and thin all points, unless that is done -> the tiles that have any, in order."""
    if files.tiles is None:
        sort_into_tiles(parts, to_asset, grid, files, part_of(tick, 0.3, 0.7))
    filled = [tile_of(name) for name in files.tiles or {}]
    for number, tile in enumerate(filled):
        if not files.path("points", name_of(tile)).exists():
            thin_tile(files, grid, tile, coloured=points.rgb is not None)
        tick(0.7 + 0.3 * number / len(filled))
    return sorted(filled)


def _mesh_work(files: SceneFolder, grid: TileGrid, noise: float) -> PartWork[Tile, Mesh]:
    """Mesh each tile from the points of it and its halo."""
    return PartWork(
        name=name_of,
        is_made=lambda tile: files.path("mesh", name_of(tile)).exists(),
        work=mesh_tile,
        inputs=lambda tile: (points_around(files, grid, tile, HALO)[0], grid, tile, noise),
        keep=lambda tile, mesh: files.save_mesh("mesh", name_of(tile), mesh),
    )


def _weld_all(files: SceneFolder, grid: TileGrid, tiles: Sequence[Tile], tick: Tick) -> None:
    """Weld all tiles that are not yet, one after the other."""
    filled = set(tiles)
    for tile in tiles:
        if not files.path("welded", name_of(tile)).exists():
            beside = [each for each in neighbours(tile) if each in filled]
            strips = [strip_of(files.load_mesh("welded", name_of(each)), grid, tile) for each in beside if each < tile]
            mesh = weld(files.load_mesh("mesh", name_of(tile)), grid, tile, beside, strips)
            files.save_mesh("welded", name_of(tile), mesh)
        tick(1.0)


def _levels(
    engine: Engine | None, levels: LevelFiles, tiles: Sequence[Tile], bar: Bar
) -> Generator[Progress, None, TiledScene]:
    """Make the tiles as they are delivered and their ancestors, level by level, up to a single one.

    Raises EdgeError EXTRACTION_EMPTY.
    """
    nodes = [Node(0, tile) for tile in tiles]
    yield from run_parts(engine, nodes, levels.work_of_tiles(), Span(bar, "TEXTURING", end=_TILES_SHARE))
    nodes = [node for node in nodes if levels.figures(node).triangles]
    if not nodes:
        hints = (say("capture_scene_from_closer"),)
        raise EdgeError("EXTRACTION_EMPTY", say("no_surface_found_in_any"), hints=hints)
    every, triangles = list(nodes), sum(levels.figures(node).triangles for node in nodes)
    tiles_made, children = len(nodes), dict[Node, list[Node]]()
    while len(nodes) > 1:
        for node in nodes:
            children.setdefault(node.parent, []).append(node)
        nodes = list(dict.fromkeys(node.parent for node in nodes))
        span = Span(bar, "TEXTURING", partial(_parts_done, nodes[0].level), begin=_TILES_SHARE)
        yield from run_parts(engine, nodes, levels.work_of_ancestors(children), span)
        every += nodes
    (root,) = nodes
    paths = {node.file: levels.folder.path("level", node.name, ".glb") for node in every}
    mesh = levels.folder.load_mesh("level", root.name)
    tree = levels.tree(root, children)
    files = {each.name: paths[each.file] for each in tree}
    points = sum((levels.folder.tiles or {}).values())
    return TiledScene(tree, files, mesh, levels.grid, points, tiles_made, triangles, root.level + 1)


def _parts_done(level: int, done: int, total: int) -> str:
    return say("parts_of_level_done", done=done, total=total, level=level)
