"""Check the depth of a view against other views: forward-backward reprojection consistency."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Floats, Ints
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
    rows, columns = np.nonzero(depth)
    z = depth[rows, columns]
    # In the view's own frame, single precision is enough wherever in the world it is.
    places = _back_project(home.camera, columns, rows, z)
    strict, loose = np.zeros(depth.shape, np.int16), np.zeros(depth.shape, np.int16)
    for other in others:
        off, back_px = _differences(places, home, np.stack([columns, rows]), z, pictures[other], depths[other])
        for count, most in ((strict, STRICT), (loose, LOOSE)):
            count[rows, columns] += (off < most.relative) & (back_px < most.back_px)
    return strict, loose


def _differences(
    places: Floats, home: UndistortedPhoto, pixel: Ints, z_home: Floats, away: UndistortedPhoto, depth_away: Floats
) -> tuple[Floats, Floats]:
    """Return how far the view `away` differs about the depths z_home (N,) of pixels (2,N) of `home`.

    places (3,N): the pixels' points in the frame of `home`. A point has to be on the surface that `away` sees, and this
    surface's point has to project back to the same pixel and depth. Returns the larger relative difference of the two
    depths (N,), and the distance in pixels (N,); both are infinite where `away` sees nothing there."""
    to_away = away.world_to_camera @ np.linalg.inv(home.world_to_camera)
    u, v, z = _project(away.camera, to_away, places)
    height, width = depth_away.shape
    inside = (z > 0) & (u > -0.5) & (u < width - 0.5) & (v > -0.5) & (v < height - 0.5)
    off, back_px = np.full(len(z), np.inf, np.float32), np.full(len(z), np.inf, np.float32)
    index = np.flatnonzero(inside)
    column, row = np.rint(u[index]).astype(np.int32), np.rint(v[index]).astype(np.int32)
    seen = depth_away[row, column]
    near = np.abs(seen - z[index]) < LOOSE.relative * z[index]
    index, column, row, seen = index[near], column[near], row[near], seen[near]
    back_u, back_v, back_z = _project(
        home.camera, np.linalg.inv(to_away), _back_project(away.camera, column, row, seen)
    )
    off[index] = np.maximum(np.abs(seen / z[index] - 1), np.abs(back_z / z_home[index] - 1))
    # The other view's pixel is rounded, which adds up to .71 px to the distance.
    back_px[index] = np.hypot(back_u - pixel[0, index], back_v - pixel[1, index]) - 0.71
    return off, back_px


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
