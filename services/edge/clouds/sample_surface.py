"""Sample points uniformly by area on the surface of triangle meshes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture2vr.edge.arrays import Bytes, Floats, Ints
from capture2vr.edge.capture.nouns import Cloud
from capture2vr.edge.errors import CaptureError
from capture2vr.sentences.sentence import say

SAMPLES = 100_000  # points per mesh file: 3 mm apart on a square metre
MAX_FACES = 5_000_000  # summed over all nodes, as a scene can repeat one mesh a million times; 200 bytes each
SEED = 0  # of the random generator: the same mesh always gives the same points

ColourAt = Callable[[Ints, Floats], Bytes]
"""Triangle indices (N,) and barycentric weights (N,3) -> (N,3) uint8 sRGB."""
IsThere = Callable[[Ints, Floats], NDArray[np.bool_]]
"""Triangle indices (N,) and barycentric weights (N,3) -> (N,): whether the surface is there, or cut out."""
_PROBES = 50  # least points by which the share of a surface that is there is told
_MOST_DRAWN = 10  # times the points that are kept, where little of a surface is there


@dataclass(frozen=True, slots=True)
class SampledSurface:
    """Triangles to sample: vertices (V,3) in the capture frame, faces (F,3), and a function for colours, if any.

    is_there: where the surface is cut out, as leaves are of their quads
    """

    vertices: Floats
    faces: Ints
    colour_at: ColourAt | None = None
    is_there: IsThere | None = None


def too_many_faces(count: int, file: str) -> CaptureError:
    """Return a CAPTURE_TOO_LARGE error for a file of `count` triangles."""
    what = say("has_triangles_most_read", count=count, most=MAX_FACES)
    return CaptureError("CAPTURE_TOO_LARGE", what, file=file, hints=(say("simplify_mesh"),))


def sample_surfaces(surfaces: Sequence[SampledSurface], file: str) -> Cloud:
    """Sample SAMPLES points on all surfaces together, uniform by area, with face normals and, if any has them, colours.

    About as many where surfaces are cut out. A triangle with a coordinate that is not finite counts as area 0.
    Raises CAPTURE_DEGENERATE where nothing has an area.
    """
    corners = [surface.vertices[surface.faces].astype(np.float64) for surface in surfaces]
    with np.errstate(invalid="ignore", over="ignore"):
        crosses = [np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0]) for c in corners]
        areas = [np.nan_to_num(np.linalg.norm(cross, axis=1), nan=0, posinf=0) for cross in crosses]
    rng = np.random.default_rng(SEED)
    total = sum(float(area.sum()) for area in areas)
    shown = [_share_there(surface, area, total, rng) for surface, area in zip(surfaces, areas, strict=True)]
    parts = np.array([float(area.sum()) * share for area, share in zip(areas, shown, strict=True)])
    if not 0 < parts.sum() < np.inf:
        what = say("mesh_cut_out_everywhere") if 0 < total < np.inf else say("mesh_whose_triangles")
        raise CaptureError("CAPTURE_DEGENERATE", what, file=file)
    clouds = []
    coloured = any(surface.colour_at for surface in surfaces)
    counts = rng.multinomial(SAMPLES, parts / parts.sum())  # in proportion to what is there
    for surface, c, cross, area, count, share in zip(surfaces, corners, crosses, areas, counts, shown, strict=True):
        if count:
            triangle = _pick(area, math.ceil(count * min(_MOST_DRAWN, 1 / share)), rng)
            clouds.append(
                _points(surface, c[triangle], cross[triangle] / area[triangle, None], triangle, coloured, rng)
            )
    return _concatenate(clouds)


def _share_there(surface: SampledSurface, area: Floats, total: float, rng: np.random.Generator) -> float:
    """Return which share of a surface's area is there: 1 unless it is cut out. A larger one is looked at more closely.

    total: area of all surfaces
    """
    if surface.is_there is None or not 0 < total < np.inf or not area.any():
        return 1.0
    probes = _PROBES + int(SAMPLES * float(area.sum()) / total)
    return float(surface.is_there(_pick(area, probes, rng), _barycentric(probes, rng)).mean())


def _pick(area: Floats, count: int, rng: np.random.Generator) -> Ints:
    """Choose a triangle for each of `count` points, stratified by cumulative area: exact shares to within one point."""
    heights = (np.arange(count) + rng.random(count)) * (float(area.sum()) / count)
    return np.minimum(np.searchsorted(np.cumsum(area), heights), len(area) - 1)


def _points(
    surface: SampledSurface, corners: Floats, normals: Floats, triangle: Ints, coloured: bool, rng: np.random.Generator
) -> Cloud:
    """Sample one point in each triangle of `corners` (N,3,3), where it is there; white where it has no colours."""
    weights = _barycentric(len(triangle), rng)
    if surface.is_there is not None:
        there = surface.is_there(triangle, weights)
        corners, normals, triangle, weights = corners[there], normals[there], triangle[there], weights[there]
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
