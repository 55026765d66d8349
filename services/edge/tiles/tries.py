"""How often a tile is tried, and the error where it fails each time."""

from __future__ import annotations

from services.edge.errors import EdgeError
from services.edge.tiles.grid import Tile, name_of

TRIES = 3
"""How often a tile is tried before the job fails."""


def tile_failed(tile: Tile, error: Exception) -> EdgeError:
    """Return the error of a tile that has failed each time, the last time by `error`."""
    return EdgeError(
        "TILE_FAILED",
        f"tile {name_of(tile)} of the scene failed {TRIES} times: {str(error) or type(error).__name__}",
        hints=("send the scene without that part", "or use preset scene, which makes one coarser mesh"),
    )
