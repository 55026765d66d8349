"""Check the depth of a view against other views: forward-backward reprojection consistency."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Floats, Ints
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
    depth = depths[view]
    rows, columns = np.nonzero(depth)
    z = depth[rows, columns]
    world = _back_project(pictures[view], columns, rows, z)
    strict, loose = np.zeros(depth.shape, np.int16), np.zeros(depth.shape, np.int16)
    for other in others:
        off, back_px = _differences(world, pictures[view], np.stack([columns, rows]), z, pictures[other], depths[other])
        for count, most in ((strict, STRICT), (loose, LOOSE)):
            count[rows, columns] += (off < most.relative) & (back_px < most.back_px)
    return strict, loose


def _differences(
    world: Floats, home: UndistortedPhoto, pixel: Ints, z_home: Floats, away: UndistortedPhoto, depth_away: Floats
) -> tuple[Floats, Floats]:
    """Return how far the view `away` differs about the depths z_home (N,) of pixels (2,N) of `home`.

    world (3,N): the pixels' points. A point has to be on the surface that `away` sees, and this surface's point has to
    project back to the same pixel and depth. Returns the larger relative difference of the two depths (N,), and the
    distance in pixels (N,); both are infinite where `away` sees nothing there."""
    u, v, z = _project(away, world)
    height, width = depth_away.shape
    inside = (z > 0) & (u > -0.5) & (u < width - 0.5) & (v > -0.5) & (v < height - 0.5)
    off, back_px = np.full(len(z), np.inf), np.full(len(z), np.inf)
    index = np.flatnonzero(inside)
    column, row = np.rint(u[index]).astype(np.int32), np.rint(v[index]).astype(np.int32)
    seen = depth_away[row, column]
    near = np.abs(seen - z[index]) < LOOSE.relative * z[index]
    index, column, row, seen = index[near], column[near], row[near], seen[near]
    back_u, back_v, back_z = _project(home, _back_project(away, column, row, seen))
    off[index] = np.maximum(np.abs(seen / z[index] - 1), np.abs(back_z / z_home[index] - 1))
    # The other view's pixel is rounded, which adds up to .71 px to the distance.
    back_px[index] = np.hypot(back_u - pixel[0, index], back_v - pixel[1, index]) - 0.71
    return off, back_px


def _back_project(picture: UndistortedPhoto, columns: Ints, rows: Ints, z: Floats) -> Floats:
    """Back-project pixels at depth z to points (3,N) float64."""
    camera, pose = picture.camera, picture.view.camera_to_world
    local = np.stack([(columns - camera.cx) / camera.fx * z, (rows - camera.cy) / camera.fy * z, z])
    world: Floats = pose[:3, :3] @ local + pose[:3, 3:]
    return world


def _project(picture: UndistortedPhoto, world: Floats) -> tuple[Floats, Floats, Floats]:
    """Project points (3,N) to u, v in pixels, and z; for points behind the camera z <= 0, and u, v are meaningless."""
    camera = picture.camera
    x, y, z = picture.world_to_camera[:3, :3] @ world + picture.world_to_camera[:3, 3:]
    safe = np.where(z > 0, z, 1)
    return x / safe * camera.fx + camera.cx, y / safe * camera.fy + camera.cy, z
