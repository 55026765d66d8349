"""Bake a normal map: the shape of the full mesh as a texture of a simplified one, so that it is lit like the full mesh.

Each texel takes the normal of the full mesh straight above or below its place, in the frame of tangents that glTF 2.0
defines: red along u, green against v (up in the picture), blue along the vertices' normals.
"""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Floats, Tick, no_tick, part_of
from capture2vr.edge.export.shading import shaded, with_tangents
from capture2vr.edge.mesh.normals import vertex_normals
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.edge.parallel import in_threads, slices
from capture2vr.edge.render.rays import RaycastingScene, nearest_along
from capture2vr.edge.texture.bake import add_rim_texels, fill_unknown, find_texels, interpolate, jpeg_of

_REACH = 0.01  # of the longest side: farther off, a simplified mesh stands for something else
_LEAST_COSINE = 0.3  # 73°: between normals that differ more lies a fold or another sheet
_LEAST_DETAIL = 0.02  # mean tilt of the normals, about one degree, below which nobody sees a normal map
_QUALITY = 90  # of the JPEG
_FOUND = 0.4  # of the time goes into finding the texels
_AT_ONCE = 1 << 16  # texels looked up together: their arrays fit into the processor's cache


class FullShape:
    """A full mesh whose normals are baked for its levels of detail, in their frame."""

    def __init__(self, full: Mesh) -> None:
        self.faces = len(full.faces)
        self._full, self._scene, self._normals = full, RaycastingScene(full), vertex_normals(full)

    def normals_at(self, places: Floats, normals: Floats) -> Floats:
        """Look up unit normals (N,3) at places (N,3) of a level of detail with unit normals (N,3), on their side.

        The level's own where the full mesh is farther off than 1 % of its longest side, or bends away.
        """
        detail = normals.copy()

        def look_up(part: slice) -> None:
            hits = nearest_along(self._scene, places[part], normals[part], _REACH * self._scene.longest)
            hit = np.flatnonzero(hits.face >= 0)
            found = interpolate(self._normals, self._full.faces[hits.face[hit]], hits.bary[hit])
            found /= np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-12)
            own = normals[part][hit]
            cosine = np.einsum("nx,nx->n", found, own)
            alike = np.abs(cosine) > _LEAST_COSINE
            detail[part.start + hit[alike]] = (np.sign(cosine)[:, None] * found)[alike]

        in_threads(look_up, slices(len(places), _AT_ONCE))
        return detail


def bake_normals(level: TexturedMesh, full: FullShape, *, side: int, tick: Tick = no_tick) -> bytes | None:
    """Bake the normal map of a textured level of detail, side × side texels, as JPEG.

    None where the full mesh is lit as the level is already.
    """
    surface = with_tangents(shaded(level))
    assert surface.uv is not None
    assert surface.tangents is not None
    inner = find_texels(surface.mesh.faces, surface.uv, side, part_of(tick, 0, _FOUND))
    texels = add_rim_texels(inner, surface.mesh.faces, surface.uv, side)
    corners = surface.mesh.faces[texels.face]
    places = interpolate(surface.mesh.vertices, corners, texels.bary)
    normals = interpolate(surface.normals, corners, texels.bary)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    detail = full.normals_at(places, normals)
    tangents = interpolate(surface.tangents[:, :3], corners, texels.bary)
    tangents -= np.einsum("nx,nx->n", tangents, normals)[:, None] * normals
    tangents /= np.maximum(np.linalg.norm(tangents, axis=1, keepdims=True), 1e-12)
    bitangents = np.cross(normals, tangents) * surface.tangents[corners[:, 0], 3:]
    local = np.stack([np.einsum("nx,nx->n", detail, axis) for axis in (tangents, bitangents, normals)], axis=1)
    if np.abs(local[:, :2]).mean() < _LEAST_DETAIL:
        return None
    picture, known = np.zeros((side * side, 3), np.uint8), np.zeros(side * side, bool)
    picture[texels.place] = np.rint((local + 1) * 127.5).clip(0, 255).astype(np.uint8)
    known[texels.place] = True
    tick(1)
    return jpeg_of(fill_unknown(picture.reshape(side, side, 3), known.reshape(side, side)), _QUALITY)
