"""A picture for an unwrapped mesh: every texel that lies on the surface gets the light that is there.

Texels are asked for by their centre, at (column + ½, row + ½) / side. Which triangle a centre lies on is found by rays
upon the flat charts. What lies on none takes the nearest texel's colour, so that neither the filter at a chart's rim
nor a mip, which averages across gaps, brings in anything else.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO

import numpy as np
from scipy.ndimage import distance_transform_edt

from services.edge.arrays import Bools, Bytes, Floats, Ints, Tick, no_tick
from services.edge.mesh.band import part_of
from services.edge.mesh.normals import face_normals, vertex_normals
from services.edge.mesh.nouns import Mesh
from services.edge.mesh.rays import Scene
from services.edge.srgb import to_srgb
from services.edge.threads import slices

_BAND = 1 << 18  # texels looked up together: their rays take 50 MB, and a cancelled job is heard within a second
_FOUND, _LIT = 0.2, 0.9  # of the time: where texels lie, and the light there; the rest fills the gaps

LightAt = Callable[[Floats, Floats, Tick], Floats]
"""Places (N,3) on the mesh and its unit normals (N,3) there -> (N,3) linear light."""


@dataclass(frozen=True, slots=True)
class Texels:
    """Texels on the surface: place (T,) row by row in the picture, face (T,), bary (T,3) weights of its corners."""

    place: Ints
    face: Ints
    bary: Floats


def texels_of(faces: Ints, uv: Floats, side: int, tick: Tick = no_tick) -> Texels:
    """Those of a picture of side × side whose centres lie on a chart; uv (V,2)."""
    scene = Scene(Mesh(np.concatenate([uv, np.zeros((len(uv), 1))], axis=1), faces))
    ahead, found = np.array([[0.0, 0.0, 1.0]]), []
    for part in slices(side * side, _BAND):
        row, column = np.divmod(np.arange(part.start, part.stop), side)
        start = np.stack([(column + 0.5) / side, (row + 0.5) / side, np.full(len(row), -1.0)], axis=1)
        hits = scene.cast(start, np.broadcast_to(ahead, start.shape))
        on = np.flatnonzero(hits.face >= 0)
        found.append((on + part.start, hits.face[on], hits.bary[on]))
        tick(part.stop / side**2)
    place, face, bary = (np.concatenate(each) for each in zip(*found, strict=True))
    return Texels(place, face, bary)


def with_rims(inner: Texels, faces: Ints, uv: Floats, side: int) -> Texels:
    """And those that hold a corner or the middle of a triangle: one too thin for any centre would show its neighbour
    chart's colour, a speck."""
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
    """The picture (side,side,3) uint8 sRGB of an unwrapped mesh, and how many of its texels lie on the surface: none
    where it is too small for the charts, and then it is black."""
    inner = texels_of(mesh.faces, uv, side, part_of(tick, 0, _FOUND))
    if len(inner.place) == 0:
        return np.zeros((side, side, 3), np.uint8), 0
    texels = with_rims(inner, mesh.faces, uv, side)
    places, normals = places_on(mesh, texels.face, texels.bary)
    picture, known = np.zeros((side * side, 3), np.uint8), np.zeros(side * side, bool)
    picture[texels.place] = to_srgb(light_at(places, normals, part_of(tick, _FOUND, _LIT)))
    known[texels.place] = True
    filled = _filled(picture.reshape(side, side, 3), known.reshape(side, side))
    tick(1)
    return filled, len(inner.place)


def scattered(mesh: Mesh, count: int) -> tuple[Ints, Floats]:
    """So many places all over a mesh, the same for the same mesh: (N,) face, (N,3) weights of its corners."""
    area = np.linalg.norm(face_normals(mesh.vertices, mesh.faces), axis=1)
    rng = np.random.default_rng(0)
    return rng.choice(len(area), count, p=area / area.sum()), rng.dirichlet(np.ones(3), count)


def blended(values: Floats, corners: Ints, weight: Floats) -> Floats:
    """(N,3) values (V,3) of vertices at places with these corners (N,3) and their weights (N,3)."""
    mixed = np.zeros((len(corners), 3))
    for corner in range(3):  # one after the other: all at once would take three times the memory
        mixed += weight[:, corner, None] * values[corners[:, corner]]
    return mixed


def places_on(mesh: Mesh, face: Ints, weight: Floats) -> tuple[Floats, Floats]:
    """Where places on faces (N,) with weights (N,3) of their corners are, (N,3), and the unit normals there."""
    corners = mesh.faces[face]
    place, normal = (blended(values, corners, weight) for values in (mesh.vertices, vertex_normals(mesh)))
    return place, normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)


def _filled(picture: Bytes, known: Bools) -> Bytes:
    """Texels that are not known take the colour of the nearest that is."""
    row, column = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.asarray(picture[row, column])


def jpeg_of(picture: Bytes, quality: int) -> bytes:
    """The picture as a JPEG whose colours are as sharp as its light: charts of different colours lie side by side."""
    from PIL import Image

    out = BytesIO()
    Image.fromarray(picture).save(out, "JPEG", quality=quality, subsampling=0, optimize=True)
    return out.getvalue()
