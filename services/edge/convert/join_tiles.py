"""Join the finest tiles of a scene into one mesh, for formats that know no tiles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from io import BytesIO

import numpy as np

from capture2vr.edge.convert.read_glb import StoredLevel, read_glb
from capture2vr.edge.convert.tileset_zip import tiles_in
from capture2vr.edge.mesh.concatenate import concatenate
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.edge.render.sample_image import bilinear
from capture2vr.edge.texture.nearest_colour import transfer_colours
from capture2vr.order.download_formats import TILESET

_SAME_M, _SAME = 1e-5, 1e-6
"""Vertices in the same cell of this size are one: a tenth of the grid on which all tiles have theirs, or this share of
the longest side of small scenes, whose grid is finer."""


def join_tiles(read: Callable[[str], bytes], whole: Callable[[], Mesh]) -> Mesh:
    """Join the finest tiles of a scene into one mesh, asset frame; its vertices have colours where all tiles have some.

    Vertices that neighbouring tiles share, and those that a texture's seam has doubled, become one.

    read   a file of the bundle, by name
    whole  the scene's coarse mesh: tiles whose texture only graphics cards read (KTX2) get its colours

    Raises ValueError where a file is not what it should be; what `read` and `whole` raise.
    """
    levels = [read_glb(read(name)) for name in tiles_in(read(TILESET), finest=True)]
    if not levels:
        raise ValueError(f"{TILESET} names no tiles")
    coarse = whole() if any(level.ktx2 for level in levels) else None
    return _welded([_with_vertex_colours(level, coarse) for level in levels])


def _with_vertex_colours(level: StoredLevel, coarse: Mesh | None) -> Mesh:
    if isinstance(level.mesh, TexturedMesh):
        return _sampled(level.mesh)
    if level.ktx2 and coarse is not None and coarse.rgb is not None:
        return transfer_colours(level.mesh, coarse.vertices, coarse.rgb)
    return level.mesh


def _sampled(textured: TexturedMesh) -> Mesh:
    from PIL import Image

    with Image.open(BytesIO(textured.jpeg)) as image:
        picture = np.asarray(image.convert("RGB"))
    rgb = np.rint(bilinear(picture, textured.uv.astype(np.float32))).astype(np.uint8)
    return replace(textured.mesh, rgb=rgb)


def _welded(meshes: Sequence[Mesh]) -> Mesh:
    """Put meshes together; vertices at the same place become one, with the colour of the first."""
    mesh = concatenate(meshes)
    same = min(_SAME_M, _SAME * float(np.ptp(mesh.vertices, axis=0).max())) or _SAME_M
    cells = np.rint(mesh.vertices / same).astype(np.int64)
    _, first, number = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    return mesh.with_vertices(first, number.reshape(-1)[mesh.faces])
