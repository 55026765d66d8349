"""Zip a scene in tiles (OGC 3D Tiles 1.1) as it was published: its tileset.json and all tiles that it names."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from typing import Any

from capture2vr.edge.export.obj import zip_bytes
from capture2vr.order.download_formats import TILESET


def tileset_zip(read: Callable[[str], bytes]) -> bytes:
    """Zip tileset.json with all tiles that it names. read: a file of the bundle, by name.

    Raises ValueError where tileset.json is not one, or names anything but a file beside it; what `read` raises.
    """
    document = read(TILESET)
    return zip_bytes({TILESET: document, **{name: read(name) for name in tiles_in(document)}})


def tiles_in(document: bytes, *, finest: bool = False) -> list[str]:
    """List the files that a tileset.json names, sorted. finest: only those that no finer ones replace

    Raises ValueError where it is not a tileset.json, or names anything but a file beside it.
    """
    try:
        names = sorted(set(_contents(json.loads(document)["root"], finest=finest)))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{TILESET} is not a tileset: {error}") from error
    if strange := next((name for name in names if "/" in name or "\\" in name or not name.endswith(".glb")), None):
        raise ValueError(f"{TILESET} names {strange!r}, which is no tile beside it")
    return names


def _contents(root: dict[str, Any], *, finest: bool) -> Iterator[str]:
    """Yield the name of each tile's content."""
    waiting = [root]
    while waiting:
        tile = waiting.pop()
        children = tile.get("children", [])
        if (content := tile.get("content")) and not (finest and children):
            yield str(content["uri"])
        waiting += children
