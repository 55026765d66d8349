"""Cover a coloured surface with Gaussian splats: flat ellipsoids that lie on it, evenly spread, with its colours.

Nothing is trained: a splat has the surface's place, direction and colour, and is as wide as the gap to its neighbours.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from io import BytesIO

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats, Ints
from capture2vr.edge.mesh.normals import face_normals
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.edge.render.sample_image import bilinear, shrink_to

MOST_SPLATS = 300_000
"""As many as a standalone headset sorts and draws in time."""
_WIDTH = 0.6
"""Standard deviation along the surface, over the mean distance of neighbours: with less there are gaps, with more the
colours are blurred."""
_THICKNESS = 0.1  # the same across the surface, over the one along it
THINNEST_M = 5e-5
"""The least standard deviation that .spz can store."""
_OPACITY = 0.95
_GREY = 150  # sRGB, of a surface without colours
# Steps of the R2 sequence, by the plastic number (M. Roberts, 2018): as evenly spread as a grid, in any triangle.
_PLASTIC = 1.32471795724474602596
_R2 = np.array([1 / _PLASTIC, 1 / _PLASTIC**2])


@dataclass(frozen=True, slots=True)
class Splats:
    """N Gaussian splats in the asset frame (metres, Y up).

    xyz       (N,3) float32, centres
    rotation  (N,4) float32, unit quaternions x, y, z, w, from a splat's own axes to the asset's; its third axis is the
              surface's normal
    scale     (N,3) float32, standard deviations along its own axes, metres
    opacity   (N,) float32, of its centre, in [0,1]
    rgb       (N,3) uint8 sRGB
    """

    xyz: Floats
    rotation: Floats
    scale: Floats
    opacity: Floats
    rgb: Bytes

    def __len__(self) -> int:
        return len(self.xyz)


def cover_with_splats(surface: Mesh | TexturedMesh, count: int = MOST_SPLATS) -> Splats:
    """Cover a surface in the asset frame with `count` splats. Raises ValueError where it has no area.

    Every triangle gets its share by area: the whole number of splats in it is off by less than one, wherever it is.
    """
    mesh = surface.mesh if isinstance(surface, TexturedMesh) else surface
    corners = np.asarray(mesh.vertices, np.float64)[mesh.faces]
    normals = face_normals(np.asarray(mesh.vertices, np.float64), mesh.faces)
    doubled = np.linalg.norm(normals, axis=1)
    total = float(doubled.sum()) / 2
    if not total > 0:
        raise ValueError(f"a mesh of {len(mesh.faces)} faces without area cannot be covered with splats")
    spacing = math.sqrt(total / count)
    face, bary = _even_places(doubled, count)
    width = _WIDTH * spacing
    thickness = max(_THICKNESS * width, THINNEST_M)
    return Splats(
        np.einsum("nc,ncx->nx", bary, corners[face]).astype(np.float32),
        _turns_to(normals[face] / doubled[face, None]).astype(np.float32),
        np.tile(np.array([width, width, thickness], np.float32), (count, 1)),
        np.full(count, _OPACITY, np.float32),
        _colours(surface, mesh.faces[face], bary, spacing),
    )


def _even_places(areas: Floats, count: int) -> tuple[Ints, Floats]:
    """Faces (N,) and barycentric coordinates (N,3) of `count` places: at even steps of the running sum of areas."""
    ends = np.cumsum(areas)
    steps = (np.arange(count) + 0.5) * (ends[-1] / count)
    face: Ints = np.minimum(np.searchsorted(ends, steps, side="right"), len(areas) - 1)
    u, v = ((np.arange(count)[:, None] * _R2) % 1).T
    outside = u + v > 1  # of the triangle, in the other half of the parallelogram
    u, v = np.where(outside, 1 - u, u), np.where(outside, 1 - v, v)
    return face, np.stack([1 - u - v, u, v], axis=1)


def _turns_to(normal: Floats) -> Floats:
    """Quaternions (N,4), x, y, z, w, of the shortest turns from the third axis to unit normals (N,3)."""
    x, y, z = normal.T
    turn = np.stack([-y, x, np.zeros_like(x), 1 + z], axis=1)
    turn[z < -1 + 1e-9] = (1, 0, 0, 0)  # half a turn, about any axis across
    unit: Floats = turn / np.linalg.norm(turn, axis=1, keepdims=True)
    return unit


def _colours(surface: Mesh | TexturedMesh, corners: Ints, bary: Floats, spacing: float) -> Bytes:
    """Colours (N,3) at places in triangles with these corners (N,3)."""
    if isinstance(surface, TexturedMesh):
        uv = np.einsum("nc,ncx->nx", bary, surface.uv[corners])
        return _rounded(bilinear(_shrunk_texture(surface, spacing), uv.astype(np.float32)))
    if surface.rgb is None:
        return np.full((len(corners), 3), _GREY, np.uint8)
    return _rounded(np.einsum("nc,ncx->nx", bary, surface.rgb[corners].astype(np.float64)))


def _shrunk_texture(surface: TexturedMesh, spacing: float) -> Bytes:
    """The texture with texels about as large as a splat, each the mean of what it covers: single ones would alias."""
    from PIL import Image

    with Image.open(BytesIO(surface.jpeg)) as image:
        picture = np.asarray(image.convert("RGB"))
    shrink = max(1.0, spacing / max(_texel_m(surface), 1e-12))
    return shrink_to(picture, max(1, round(max(picture.shape[:2]) / shrink)))


def _texel_m(surface: TexturedMesh) -> float:
    """Mean side of a texel on the surface, metres: from the areas in the texture and in space."""
    corners = surface.uv[surface.mesh.faces]
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    in_texture = float(np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]).sum())
    in_space = float(np.linalg.norm(face_normals(surface.mesh.vertices, surface.mesh.faces), axis=1).sum())
    return math.sqrt(in_space / max(in_texture, 1e-12)) / surface.side


def _rounded(values: Floats) -> Bytes:
    return np.rint(values).clip(0, 255).astype(np.uint8)
