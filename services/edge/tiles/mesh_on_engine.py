"""Mesh the tiles of a scene side by side on an engine: a task gets the points of a tile and of its halo."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, wait

from services.edge.arrays import Floats, Tick
from services.edge.engine.nouns import Engine, Needs, Submitted
from services.edge.errors import EdgeError
from services.edge.mesh.nouns import Mesh
from services.edge.progress import Bar, Progress
from services.edge.tiles.folder import SceneFolder
from services.edge.tiles.grid import HALO, Tile, TileGrid, name_of
from services.edge.tiles.mesh_tile import mesh_tile
from services.edge.tiles.tile_points import points_around
from services.edge.tiles.tries import TRIES, tile_failed

TILE_NEEDS = Needs(cpus=1, memory_bytes=1 << 30)
"""Of a tile of 256 cells a side: see `grid.SIDE`."""

_AHEAD = 32  # tiles that are submitted at once; each one's points take some 10 MB in the engine
_POLL_S = 0.5  # between two looks whether the job was cancelled


def mesh_on_engine(
    engine: Engine, files: SceneFolder, grid: TileGrid, noise: float, tiles: Sequence[Tile], bar: Bar
) -> Generator[Progress, None, None]:
    """Mesh the tiles that have no mesh yet, and write the meshes to the scene's folder as they come.

    Raises EdgeError TILE_FAILED, which names the tile; ENGINE_LOST, TASK_LOST; and Cancelled as `bar` does. The meshes
    that have come are kept.
    """
    waiting = deque(tile for tile in tiles if not files.path("mesh", name_of(tile)).exists())
    done, failures = len(tiles) - len(waiting), Counter[Tile]()
    running: dict[Tile, Submitted[Mesh]] = {}
    try:
        while waiting or running:
            while waiting and len(running) < _AHEAD:
                tile = waiting.popleft()
                cells, _ = points_around(files, grid, tile, HALO)
                running[tile] = engine.submit(TILE_NEEDS, mesh_task, cells, grid, tile, noise)
            for tile in _ended(running, bar.tick("EXTRACTING"), done / len(tiles)):
                try:
                    files.save_mesh("mesh", name_of(tile), running.pop(tile).result(0))
                except EdgeError:
                    raise
                except Exception as error:
                    failures[tile] += 1
                    if failures[tile] == TRIES:
                        raise tile_failed(tile, error) from error
                    waiting.append(tile)
                else:
                    done += 1
                    yield bar.advance("EXTRACTING", done / len(tiles), f"{done} of {len(tiles)} tiles")
    finally:
        for task in running.values():
            task.cancel()


def mesh_task(tick: Tick, cells: Floats, grid: TileGrid, tile: Tile, noise: float) -> Mesh:
    """Mesh one tile, on any machine: `mesh_tile` as a task of an engine."""
    return mesh_tile(cells, grid, tile, noise, tick)


def _ended(running: dict[Tile, Submitted[Mesh]], tick: Tick, fraction: float) -> list[Tile]:
    """Wait until some of the tasks have ended; return their tiles. Meanwhile `tick` may raise."""
    while True:
        tick(fraction)
        wait([task.future for task in running.values()], _POLL_S, FIRST_COMPLETED)
        if ended := [tile for tile, task in running.items() if task.future.done()]:
            return ended
