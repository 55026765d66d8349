"""Which depths of a view other views confirm: there they land on a surface that lands back on the same pixel."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from services.edge.arrays import Bools, Floats, Ints
from services.edge.photos.pictures import Picture

_RELATIVE = 0.006
"""Difference of depth that is still agreement: a pixel's error at the angles that stereo works with."""
_BACK_PX = 1.0
"""Pixels from where it came that a point may land when it is brought back by the other view's depth."""


def confirmations(view: int, others: Sequence[int], pictures: Sequence[Picture], depths: Sequence[Floats]) -> Ints:
    """(H,W) how many of the `others` agree with the depth of every pixel of `view`. 0 stands for unknown depth."""
    depth = depths[view]
    rows, columns = np.nonzero(depth)
    z = depth[rows, columns]
    world = _world(pictures[view], columns, rows, z)
    count = np.zeros(depth.shape, np.int16)
    for other in others:
        agrees = _agrees(world, pictures[view], np.stack([columns, rows]), z, pictures[other], depths[other])
        count[rows, columns] += agrees
    return count


def _agrees(world: Floats, home: Picture, pixel: Ints, z_home: Floats, away: Picture, depth_away: Floats) -> Bools:
    u, v, z = _project(away, world)
    height, width = depth_away.shape
    inside = (z > 0) & (u > -0.5) & (u < width - 0.5) & (v > -0.5) & (v < height - 0.5)
    agrees = np.zeros(len(z), bool)
    index = np.flatnonzero(inside)
    column, row = np.rint(u[index]).astype(np.int32), np.rint(v[index]).astype(np.int32)
    seen = depth_away[row, column]
    near = np.abs(seen - z[index]) < _RELATIVE * z[index]
    index, column, row, seen = index[near], column[near], row[near], seen[near]
    back_u, back_v, back_z = _project(home, _world(away, column, row, seen))
    off = np.hypot(back_u - pixel[0, index], back_v - pixel[1, index])
    # The neighbour's pixel is rounded: up to .71 px of the distance is its, on top of what the depths disagree by.
    agrees[index] = (off < _BACK_PX + 0.71) & (np.abs(back_z - z_home[index]) < _RELATIVE * z_home[index])
    return agrees


def _world(picture: Picture, columns: Ints, rows: Ints, z: Floats) -> Floats:
    """(3,N) float64 points at depth z of the pixels."""
    camera, pose = picture.camera, picture.view.camera_to_world
    local = np.stack([(columns - camera.cx) / camera.fx * z, (rows - camera.cy) / camera.fy * z, z])
    world: Floats = pose[:3, :3] @ local + pose[:3, 3:]
    return world


def _project(picture: Picture, world: Floats) -> tuple[Floats, Floats, Floats]:
    """u, v in pixels and z of points (3,N); behind the camera z is not positive and u, v mean nothing."""
    camera = picture.camera
    x, y, z = picture.world_to_camera[:3, :3] @ world + picture.world_to_camera[:3, 3:]
    safe = np.where(z > 0, z, 1)
    return x / safe * camera.fx + camera.cx, y / safe * camera.fy + camera.cy, z
