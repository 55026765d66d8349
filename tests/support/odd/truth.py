"""What a file means, and whether a reading of it is that: points, their places in metres, and their colours."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.nouns import Capture

Judge = Callable[[Capture], str]
"""A reading -> what of it is wrong; "" where nothing is."""

_SOME = 400  # points of a surface that are looked at one by one
_LIKE = 0.03  # share by which the spread of the points of a surface may differ from that of the surface


@dataclass(frozen=True, slots=True)
class Truth:
    """What a file means.

    xyz         (N,3) its points in their order, in metres or in units that have no name; of a surface (F,3,3)
    rgb         (N,3), of a surface (F,3), 0 to 255; None where it has no colours
    is_surface  whether points are sampled on triangles
    near        how far a coordinate may be off
    shade       how far a colour may be off
    """

    xyz: Floats
    rgb: np.ndarray | None = None
    is_surface: bool = False
    near: float = 1e-4
    shade: float = 1.0


def fault(capture: Capture, truth: Truth) -> str:
    """Return what of a reading is not what the file means; "" where all is."""
    cloud = capture.cloud
    if cloud is None:
        return f"taken for {capture.kind}"
    xyz = (cloud.xyz + (0 if cloud.origin is None else cloud.origin)) * capture.metres_per_unit
    if (cloud.rgb is None) != (truth.rgb is None):
        return "no colours" if cloud.rgb is None else "colours that it has not"
    if truth.is_surface:
        return _fault_of_surface(xyz, cloud.rgb, truth)
    if len(xyz) != len(truth.xyz):
        return f"{len(xyz)} points instead of {len(truth.xyz)}"
    if (off := float(np.abs(xyz - truth.xyz).max())) > truth.near:
        return f"coordinates off by {off:.3g}"
    return _fault_of_colours(cloud.rgb, truth.rgb, truth.shade)


def judge_of(truth: Truth) -> Judge:
    """Return what finds the faults of a reading of a file that means this."""
    return lambda capture: fault(capture, truth)


def _fault_of_surface(xyz: Floats, rgb: np.ndarray | None, truth: Truth) -> str:
    some = np.arange(0, len(xyz), max(1, len(xyz) // _SOME))
    distance, nearest = nearest_triangles(xyz[some], truth.xyz)
    if distance.max() > truth.near:
        share = np.mean(distance > truth.near)
        return f"{100 * share:.0f} % of the points off the surface, up to {distance.max():.3g}"
    (middle, spread), meant = (xyz.mean(axis=0), xyz.T @ xyz / len(xyz)), moments(truth.xyz)
    scale = float(np.sqrt(np.trace(meant[1] - np.outer(meant[0], meant[0]))))
    if np.abs(middle - meant[0]).max() > _LIKE * scale:
        return f"the middle of the surface off by {np.abs(middle - meant[0]).max():.3g}"
    spread, meant_spread = spread - np.outer(middle, middle), meant[1] - np.outer(*[meant[0]] * 2)
    if np.abs(spread - meant_spread).max() > _LIKE * scale**2:
        return "points spread in another way than the surface"
    return _fault_of_colours(None if rgb is None else rgb[some], truth.rgb, truth.shade, nearest)


def _fault_of_colours(
    rgb: np.ndarray | None, meant: np.ndarray | None, shade: float, of: np.ndarray | None = None
) -> str:
    if rgb is None or meant is None:
        return ""
    meant = meant if of is None else meant[of]
    off = np.abs(rgb.astype(float) - meant).max(axis=1)
    return f"{100 * np.mean(off > shade):.0f} % of the colours off, up to {off.max():.0f}" if off.max() > shade else ""


def moments(triangles: Floats) -> tuple[Floats, Floats]:
    """Return the mean (3,) of a surface, evenly over its area, and that of the products of coordinates (3,3)."""
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    share = np.linalg.norm(cross, axis=1)
    share = share / share.sum()
    middle = triangles.mean(axis=1)
    # Of a triangle with corners a, b, c and the middle m: (aa + bb + cc + 9 mm) / 12.
    corners = np.einsum("f,fci,fcj->ij", share, triangles, triangles)
    return share @ middle, (corners + 9 * np.einsum("f,fi,fj->ij", share, middle, middle)) / 12


def nearest_triangles(points: Floats, triangles: Floats) -> tuple[Floats, np.ndarray]:
    """Return how far points (N,3) are from triangles (F,3,3), and which of them is the nearest: (N,), (N,)."""
    from trimesh.triangles import closest_point

    count = len(triangles)
    every = np.repeat(points, count, axis=0)
    closest = closest_point(np.tile(triangles, (len(points), 1, 1)), every)
    distance = np.linalg.norm(closest - every, axis=1).reshape(len(points), count)
    return distance.min(axis=1), distance.argmin(axis=1)
