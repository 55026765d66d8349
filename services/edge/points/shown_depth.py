"""Tell up to which depth a photo shows what lies on the way of its rays."""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Floats, Ints

_TOLERANCE = 0.03
"""Relative depth behind the surface that a photo shows up to which a point is still that surface: fused depth errs by
1 %, and a sheet shall go with both its sides. At arm's length 2 cm."""
_CELL_PX = 4
"""Side, in pixels of the depth image, of the cells in which points hide each other: fused points are 2 pixels apart."""
_AROUND = np.ones((3, 3), np.uint8)  # a pixel, or a cell, and those beside it: a surface may be seen at a slant


def shown_depth(depth: Floats, at: Floats, z: Floats) -> Floats:
    """Return for each pixel (H,W) the depth up to which a photo shows places; infinite where it shows no surface.

    depth (H,W) of its image, 0 where unknown: there the points hide each other. at (M,2) their positions inside it, in
    shares of its sides, and z (M,) their depths.
    """
    import cv2

    surface = cv2.dilate(np.ascontiguousarray(depth, np.float32), _AROUND)
    return np.asarray((1 + _TOLERANCE) * np.where(surface > 0, surface, _nearest_points(at, z, depth.shape)))


def _nearest_points(at: Floats, z: Floats, shape: tuple[int, ...]) -> Floats:
    """Return for each pixel (H,W) the farthest, within a cell, of the depths of the cells' nearest points (a z-buffer);
    infinite beside cells without points."""
    import cv2

    nearest = np.full(tuple(-(-side // _CELL_PX) for side in shape), np.inf, np.float32)
    row, column = (each // _CELL_PX for each in pixels_of(at, shape))
    np.minimum.at(nearest, (row, column), z.astype(np.float32))
    farthest: Floats = np.asarray(cv2.dilate(nearest, _AROUND))
    return farthest.repeat(_CELL_PX, axis=0).repeat(_CELL_PX, axis=1)[: shape[0], : shape[1]]


def pixels_of(at: Floats, shape: tuple[int, ...]) -> tuple[Ints, Ints]:
    """Return the rows and columns of positions (N,2) in an image (H,W)."""
    column, row = np.clip((at * shape[1::-1]).astype(np.int64), 0, np.array(shape[1::-1]) - 1).T
    return row, column
