"""A scene in tiles for tests: coloured hills, as a tree of .glb contents of which four replace one."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.export.glb import to_glb
from capture2vr.edge.export.tileset import TILESET_FILE, TilesetNode, tileset_json
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.storage.bundle import Bundle, sha256_hex

CELLS = 16  # along a tile's side, whatever its level


def hills(x: Floats, z: Floats) -> Floats:
    """Height in metres, at least 0, of a point of the floor."""
    return 0.6 + 0.4 * np.sin(1.7 * x) * np.cos(1.3 * z) + 0.2 * np.sin(4.1 * z)


def hill_tile(low: Floats, size_m: float, cells: int = CELLS) -> Mesh:
    """A square of the hills, from its least corner (x, z)."""
    steps = np.linspace(0, size_m, cells + 1)
    x, z = (axis.ravel() for axis in np.meshgrid(low[0] + steps, low[1] + steps, indexing="ij"))
    height = hills(x, z)
    corner = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    a, b, c, d = (each.ravel() for each in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([c, b, d], 1)])
    shade = np.clip(255 * height / 1.2, 0, 255)
    rgb = np.stack([shade, 255 - shade, np.full_like(shade, 90)], 1).astype(np.uint8)
    return Mesh(np.stack([x, height, z], 1), faces, rgb)


def hill_tree(
    files: dict[str, bytes],
    levels: int,
    low: Floats,
    size_m: float,
    cells: int = CELLS,
    dress: Callable[[Mesh], Mesh | TexturedMesh] = lambda mesh: mesh,
    level: int = 0,
    place: tuple[int, int] = (0, 0),
) -> TilesetNode:
    """The tree of tiles of a square; their contents go into `files`, after `dress` has given them textures, say."""
    mesh = hill_tile(low, size_m, cells)
    glb = to_glb(dress(mesh), "meshopt", common_step_m=1e-4)
    half = size_m / 2
    children = tuple(
        hill_tree(
            files,
            levels,
            low + half * np.array(at),
            half,
            cells,
            dress,
            level + 1,
            (2 * place[0] + at[0], 2 * place[1] + at[1]),
        )
        for at in ((0, 0), (0, 1), (1, 0), (1, 1))
        if level + 1 < levels
    )
    # The contents' coordinates are whole tenths of a millimetre: a box holds them with one to spare.
    corners = [mesh.vertices.min(axis=0) - 2e-4, mesh.vertices.max(axis=0) + 2e-4]
    corners += [corner for child in children for corner in (child.low_m, child.high_m)]
    low_m, high_m = np.min(corners, axis=0), np.max(corners, axis=0)
    error_m = 0.0 if not children else (size_m / cells) ** 2  # bilinear cells of a surface with curvature near 2
    name = f"tile-{level}-{place[0]}-{place[1]}.glb"
    node = TilesetNode(name, sha256_hex(glb), low_m, high_m, error_m, children)
    files[node.name] = glb
    return node


def hill_bundle(
    levels: int = 3,
    size_m: float = 12.0,
    cells: int = CELLS,
    dress: Callable[[Mesh], Mesh | TexturedMesh] = lambda mesh: mesh,
    to_earth: Floats | None = None,
) -> tuple[Bundle, TilesetNode]:
    """A bundle of hills in tiles, with the usual levels of detail of the whole, and its tree; perhaps of a survey."""
    low = np.full(2, -size_m / 2)
    files: dict[str, bytes] = {}
    root = hill_tree(files, levels, low, size_m, cells, dress)
    tiles = len(files)
    files[TILESET_FILE] = tileset_json(root, to_earth)
    lods = []
    for level, coarse in enumerate((24, 12, 6)):
        mesh = hill_tile(low, size_m, coarse)
        files[f"lod{level}.glb"] = to_glb(mesh, "meshopt")
        lods.append({"file": f"lod{level}.glb", "level": level, "triangles": len(mesh.faces)})
    size = root.high_m - root.low_m
    manifest = {
        "label": "Hills",
        "origin": "measured",
        "scale_confidence": "metric",
        "capture_to_asset": np.eye(4).ravel().tolist(),
        "bounds_m": [root.low_m.tolist(), root.high_m.tolist()],
        "size_m": size.tolist(),
        "lods": lods,
        "tileset": {
            "file": TILESET_FILE,
            "tiles": tiles,
            "levels": levels,
            "triangles": 2 * cells**2 * 4 ** (levels - 1),
        },
        "quality": {},
        "warnings": [],
    }
    return Bundle(state="refined", files=files, manifest=manifest, last=True), root
