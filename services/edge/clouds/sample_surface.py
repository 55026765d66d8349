"""Sample points uniformly by area on the surface of triangle meshes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats, Ints
from capture2vr.edge.capture.nouns import Cloud
from capture2vr.edge.errors import CaptureError
from capture2vr.sentences.sentence import say

SAMPLES = 100_000  # points per mesh file: 3 mm apart on a square metre
MAX_FACES = 5_000_000  # summed over all nodes, as a scene can repeat one mesh a million times; 200 bytes each
SEED = 0  # of the random generator: the same mesh always gives the same points

ColourAt = Callable[[Ints, Floats], Bytes]
"""Triangle indices (N,) and barycentric weights (N,3) -> (N,3) uint8 sRGB."""


@dataclass(frozen=True, slots=True)
class SampledSurface:
    """Triangles to sample: vertices (V,3) in the capture frame, faces (F,3), and a function for colours, if any."""

    vertices: Floats
    faces: Ints
    colour_at: ColourAt | None = None


def too_many_faces(count: int, file: str) -> CaptureError:
    """Return a CAPTURE_TOO_LARGE error for a file of `count` triangles."""
    what = say("has_triangles_most_read", count=count, most=MAX_FACES)
    return CaptureError("CAPTURE_TOO_LARGE", what, file=file, hints=(say("simplify_mesh"),))


def sample_surfaces(surfaces: Sequence[SampledSurface], file: str) -> Cloud:
    """Sample SAMPLES points on all surfaces together, uniform by area, with face normals and, if any has them, colours.

    A triangle with a coordinate that is not finite counts as area 0. Raises CAPTURE_DEGENERATE for a total area of 0.
    """
    corners = [surface.vertices[surface.faces].astype(np.float64) for surface in surfaces]
    with np.errstate(invalid="ignore", over="ignore"):
        crosses = [np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0]) for c in corners]
        areas = [np.nan_to_num(np.linalg.norm(cross, axis=1), nan=0, posinf=0) for cross in crosses]
    total = sum(float(area.sum()) for area in areas)
    if not 0 < total < np.inf:
        raise CaptureError("CAPTURE_DEGENERATE", say("mesh_whose_triangles"), file=file)
    rng = np.random.default_rng(SEED)
    clouds = []
    coloured = any(surface.colour_at for surface in surfaces)
    for surface, c, cross, area, count in zip(
        surfaces, corners, crosses, areas, _shares(areas, total, rng), strict=True
    ):
        if count:
            triangle = _pick(area, count, rng)
            clouds.append(
                _points(surface, c[triangle], cross[triangle] / area[triangle, None], triangle, coloured, rng)
            )
    return _concatenate(clouds)


def _shares(areas: list[Floats], total: float, rng: np.random.Generator) -> list[int]:
    """Distribute SAMPLES over the surfaces at random, in proportion to their areas."""
    parts = np.array([float(area.sum()) for area in areas]) / total
    return [int(count) for count in rng.multinomial(SAMPLES, parts / parts.sum())]


def _pick(area: Floats, count: int, rng: np.random.Generator) -> Ints:
    """Choose a triangle for each of `count` points, stratified by cumulative area: exact shares to within one point."""
    heights = (np.arange(count) + rng.random(count)) * (float(area.sum()) / count)
    return np.minimum(np.searchsorted(np.cumsum(area), heights), len(area) - 1)


def _points(
    surface: SampledSurface, corners: Floats, normals: Floats, triangle: Ints, coloured: bool, rng: np.random.Generator
) -> Cloud:
    """Sample one point in each triangle of `corners` (N,3,3); white where the surface has no colours."""
    weights = _barycentric(len(triangle), rng)
    xyz = np.einsum("nc,ncd->nd", weights, corners)
    rgb = None
    if coloured:
        white = np.full((len(xyz), 3), 255, np.uint8)
        rgb = surface.colour_at(triangle, weights) if surface.colour_at else white
    return Cloud(xyz, rgb, normals.astype(np.float32))


def _barycentric(count: int, rng: np.random.Generator) -> Floats:
    """Draw barycentric weights (N,3), uniform on a triangle: (1 - sqrt r, sqrt r (1 - s), sqrt r s).

    Osada et al. 2002, eq. 1.
    """
    root, s = np.sqrt(rng.random(count)), rng.random(count)
    return np.stack([1 - root, root * (1 - s), root * s], axis=1)


def _concatenate(clouds: list[Cloud]) -> Cloud:
    rgbs = [cloud.rgb for cloud in clouds if cloud.rgb is not None]
    normals = [cloud.normals for cloud in clouds if cloud.normals is not None]
    return Cloud(
        np.concatenate([cloud.xyz for cloud in clouds]),
        np.concatenate(rgbs) if rgbs else None,
        np.concatenate(normals) if normals else None,
    )
