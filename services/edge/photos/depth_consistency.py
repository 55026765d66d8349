"""Check the depth of a view against other views: forward-backward reprojection consistency."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Bools, Floats, Ints
from capture2vr.edge.capture.nouns import Intrinsics
from capture2vr.edge.photos.undistorted import UndistortedPhoto


@dataclass(frozen=True, slots=True)
class DepthTolerance:
    """How far two views may differ about one surface.

    relative  largest relative difference of their depths
    back_px   largest distance in pixels between a pixel and its reprojection through the other view's depth
    """

    relative: float
    back_px: float


STRICT = DepthTolerance(0.006, 1.0)
"""The error of one pixel at the angles used for stereo."""
LOOSE = DepthTolerance(0.012, 2.0)
"""Twice as much: dark, smooth or furry surface that is matched less well."""


def confirmations(
    view: int, others: Sequence[int], pictures: Sequence[UndistortedPhoto], depths: Sequence[Floats]
) -> tuple[Ints, Ints]:
    """Count for every pixel of `view` the `others` that agree with its depth: strictly, and loosely (H,W) each.

    In depths 0 is unknown.
    """
    depth, home = depths[view], pictures[view]
    known = depth > 0
    rows, columns = (each.astype(np.int32) for each in np.nonzero(known))
    z = depth[rows, columns]
    # In the view's own frame, single precision is enough wherever in the world it is.
    places = _back_project(home.camera, columns, rows, z)
    strict, loose = np.zeros(len(z), np.int16), np.zeros(len(z), np.int16)
    for other in others:
        near, off, back_px = _differences(places, home, (columns, rows), z, pictures[other], depths[other])
        for count, most in ((strict, STRICT), (loose, LOOSE)):
            count[near[(off < most.relative) & (back_px < most.back_px)]] += 1
    return _image(strict, known), _image(loose, known)


def _image(values: Ints, pixels: Bools) -> Ints:
    """Lay values (N,) out over the N pixels that are true, and 0 over the others: (H,W)."""
    image = np.zeros(pixels.shape, values.dtype)
    image[pixels] = values
    return image


def _differences(
    places: Floats,
    home: UndistortedPhoto,
    pixels: tuple[Ints, Ints],
    z_home: Floats,
    away: UndistortedPhoto,
    depth_away: Floats,
) -> tuple[Ints, Floats, Floats]:
    """Return how far the view `away` differs about the depths z_home (N,) of pixels of `home`, their columns and rows.

    places (3,N): the pixels' points in the frame of `home`. A point has to be on the surface that `away` sees, and this
    surface's point has to project back to the same pixel and depth. Returns the M pixels (M,) that `away` sees about
    there, of which the larger relative difference of the two depths (M,), and the distance in pixels (M,)."""
    to_away = away.world_to_camera @ np.linalg.inv(home.world_to_camera)
    u, v, z = _project(away.camera, to_away, places)
    height, width = depth_away.shape
    inside = np.flatnonzero((z > 0) & (u > -0.5) & (u < width - 0.5) & (v > -0.5) & (v < height - 0.5))
    z = z[inside]
    at = np.rint(v[inside]).astype(np.int32) * width + np.rint(u[inside]).astype(np.int32)
    seen = depth_away.ravel()[at]
    close = np.abs(seen - z) < LOOSE.relative * z
    near, seen, z = inside[close], seen[close], z[close]
    row, column = np.divmod(at[close], width)
    back_u, back_v, back_z = _project(
        home.camera, np.linalg.inv(to_away), _back_project(away.camera, column, row, seen)
    )
    off = np.maximum(np.abs(seen / z - 1), np.abs(back_z / z_home[near] - 1))
    # The other view's pixel is rounded, which adds up to .71 px to the distance.
    back_px = np.hypot(back_u - pixels[0][near], back_v - pixels[1][near]) - np.float32(0.71)
    return near, off, back_px


def _back_project(camera: Intrinsics, columns: Ints, rows: Ints, z: Floats) -> Floats:
    """Back-project pixels at depth z to points (3,N) float32 in the camera's frame."""
    x, y = ((columns - camera.cx) / camera.fx).astype(np.float32), ((rows - camera.cy) / camera.fy).astype(np.float32)
    return np.stack([x * z, y * z, z])


def _project(camera: Intrinsics, to_camera: Floats, places: Floats) -> tuple[Floats, Floats, Floats]:
    """Project points (3,N) to u, v in pixels, and z; for points behind the camera z <= 0, and u, v are meaningless."""
    x, y, z = to_camera[:3, :3].astype(np.float32) @ places + to_camera[:3, 3:].astype(np.float32)
    safe = np.where(z > 0, z, np.float32(1))
    return (
        x / safe * np.float32(camera.fx) + np.float32(camera.cx),
        y / safe * np.float32(camera.fy) + np.float32(camera.cy),
        z,
    )
