"""Bake a texture for an unwrapped mesh: every texel on the surface gets the light of its place there.

A texel stands for its centre, at (column + ½, row + ½) / side. Rays cast at the flat charts find the triangle of each
centre. A texel on no triangle takes the nearest texel's colour, so that neither filtering at a chart's rim nor a mip,
which averages across gaps, brings in other colours.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO

import numpy as np
from scipy.ndimage import distance_transform_edt

from capture2vr.edge.arrays import Bools, Bytes, Floats, Ints, Tick, no_tick, part_of
from capture2vr.edge.mesh.normals import face_normals, vertex_normals
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.parallel import in_threads, slices
from capture2vr.edge.render.rays import RaycastingScene
from capture2vr.edge.srgb import to_srgb

_BAND = 1 << 18  # texels looked up together: their rays take 50 MB, and a cancellation takes effect within a second
_AT_ONCE = 1 << 16  # texels interpolated together: their arrays fit into the processor's cache
_FIND_END, _LIGHT_END = 0.2, 0.9  # fractions of the time: finding texels, then their light; the rest fills the gaps

LightAt = Callable[[Floats, Floats, Tick], Floats]
"""Function from positions (N,3) on the mesh and unit normals (N,3) to linear light (N,3)."""


@dataclass(frozen=True, slots=True)
class Texels:
    """Texels on the surface: place (T,) index in the texture, row by row; face (T,); bary (T,3) corner weights."""

    place: Ints
    face: Ints
    bary: Floats


def find_texels(faces: Ints, uv: Floats, side: int, tick: Tick = no_tick) -> Texels:
    """Find the texels of a texture of side × side whose centres lie on a chart; uv (V,2)."""
    scene = RaycastingScene(Mesh(np.concatenate([uv, np.zeros((len(uv), 1))], axis=1), faces))
    ahead = np.array([[0.0, 0.0, 1.0]], np.float32)

    def find(part: slice) -> tuple[Ints, Ints, Floats]:
        row, column = np.divmod(np.arange(part.start, part.stop, dtype=np.int32), np.int32(side))
        start = np.stack([(column + 0.5) / side, (row + 0.5) / side, np.full(len(row), -1.0)], axis=1)
        hits = scene.cast(start, np.broadcast_to(ahead, start.shape))
        on = np.flatnonzero(hits.face >= 0)
        return on + part.start, hits.face[on], hits.bary[on]

    found = in_threads(find, slices(side * side, _BAND), tick)
    place, face, bary = (np.concatenate(each) for each in zip(*found, strict=True))
    return Texels(place, face, bary)


def add_rim_texels(inner: Texels, faces: Ints, uv: Floats, side: int) -> Texels:
    """Add the texels that contain a corner or the centre of a triangle: a thin triangle that contains no texel's centre
    would otherwise show the colour of a neighbouring chart, a speck."""
    known = np.zeros(side * side, bool)
    known[inner.place] = True
    found = [inner]
    for weight in [*np.eye(3), np.full(3, 1 / 3)]:
        at = np.einsum("c,fcx->fx", weight, uv[faces])
        column, row = np.clip(np.floor(at * side), 0, side - 1).astype(np.int64).T
        place, face = np.unique(row * side + column, return_index=True)
        new = ~known[place]
        known[place] = True
        found.append(Texels(place[new], face[new], np.tile(weight, (int(new.sum()), 1))))
    return Texels(*(np.concatenate([getattr(each, name) for each in found]) for name in ("place", "face", "bary")))


def bake(mesh: Mesh, uv: Floats, light_at: LightAt, *, side: int, tick: Tick = no_tick) -> tuple[Bytes, int]:
    """Bake the texture (side,side,3) uint8 sRGB of an unwrapped mesh; also return how many texels lie on the surface.

    They are 0 where the texture is too small for the charts; it is black then.
    """
    inner = find_texels(mesh.faces, uv, side, part_of(tick, 0, _FIND_END))
    if len(inner.place) == 0:
        return np.zeros((side, side, 3), np.uint8), 0
    texels = add_rim_texels(inner, mesh.faces, uv, side)
    places, normals = positions_and_normals(mesh, texels.face, texels.bary)
    picture, known = np.zeros((side * side, 3), np.uint8), np.zeros(side * side, bool)
    picture[texels.place] = to_srgb(light_at(places, normals, part_of(tick, _FIND_END, _LIGHT_END)))
    known[texels.place] = True
    filled = fill_unknown(picture.reshape(side, side, 3), known.reshape(side, side))
    tick(1)
    return filled, len(inner.place)


def random_places(mesh: Mesh, count: int) -> tuple[Ints, Floats]:
    """Sample `count` random places on a mesh, the same for the same mesh: (N,) face, (N,3) weights of its corners."""
    area = np.linalg.norm(face_normals(mesh.vertices, mesh.faces), axis=1)
    rng = np.random.default_rng(0)
    return rng.choice(len(area), count, p=area / area.sum()), rng.dirichlet(np.ones(3), count)


def interpolate(values: Floats, corners: Ints, weight: Floats) -> Floats:
    """Interpolate vertex values (V,3) at places given by corners (N,3) and their weights (N,3): (N,3)."""
    mixed = np.zeros((len(corners), 3))
    for corner in range(3):  # one after the other: together they would take three times the memory
        mixed += weight[:, corner, None] * values.take(corners[:, corner], axis=0)
    return mixed


def positions_and_normals(mesh: Mesh, face: Ints, weight: Floats) -> tuple[Floats, Floats]:
    """Positions (N,3) and unit normals (N,3) of places on faces (N,) with weights (N,3) of their corners."""
    place, normal = np.empty((len(face), 3)), np.empty((len(face), 3))
    normals = vertex_normals(mesh)

    def fill(part: slice) -> None:
        corners = mesh.faces.take(face[part], axis=0)
        place[part] = interpolate(mesh.vertices, corners, weight[part])
        mixed = interpolate(normals, corners, weight[part])
        normal[part] = mixed / np.maximum(np.linalg.norm(mixed, axis=1, keepdims=True), 1e-12)

    in_threads(fill, slices(len(face), _AT_ONCE))
    return place, normal


def fill_unknown(picture: Bytes, known: Bools) -> Bytes:
    """Give every unknown texel the colour of the nearest known one."""
    row, column = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.asarray(picture[row, column])


def jpeg_of(picture: Bytes, quality: int) -> bytes:
    """Encode as JPEG without chroma subsampling, because charts of different colours lie side by side."""
    from PIL import Image

    out = BytesIO()
    Image.fromarray(picture).save(out, "JPEG", quality=quality, subsampling=0, optimize=True)
    return out.getvalue()
