"""Observe surface points in a depth image and its picture: back-project pixels, weigh them, look up their colours."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats, Ints
from capture2vr.edge.capture.nouns import Intrinsics
from capture2vr.edge.points.depth_limits import DepthView
from capture2vr.edge.points.voxel_grid import Samples
from capture2vr.edge.srgb import to_linear

_FRONTAL = 2
"""Power of the cosine in a colour's weight, on top of the depth's weight: a slanted pixel mixes colours."""
_SHARP = 2
"""Power of the sharpness in a colour's weight: with half of the pictures blurred, colours are 4 levels off; with a
power of 1 it was 6, with 0 14."""
_LEAST_SHARPNESS = 1.0
"""Grey levels squared: the sharpness that rounding leaves in a picture of one colour."""


def observe(
    view: DepthView, rgb: Bytes | None, origin: Floats, within: Callable[[Floats], Bools] | None = None
) -> tuple[Samples, float]:
    """Back-project the valid pixels of a view; return the samples and the picture's sharpness, 0 without one.

    origin (3,) that the samples are relative to; within: mask (N,) of the places (N,3) that are wanted; None: all
    weight = cosine · confidence / z²: depth noise grows with z.
    """
    rows, columns = np.nonzero(view.inverse_depth)
    xyz = back_project(view.intrinsics, view.camera_to_world, rows, columns, view.inverse_depth[rows, columns], origin)
    if within is not None:
        wanted = within(xyz)
        xyz, rows, columns = xyz[wanted], rows[wanted], columns[wanted]
    inverse, confidence = view.inverse_depth[rows, columns], view.confidence[rows, columns]
    rotation = view.camera_to_world[:3, :3].astype(np.float32)
    normal = view.normal[rows, columns] @ rotation.T
    weight = view.cosine[rows, columns] * inverse * inverse * np.maximum(confidence, 0.05)
    light: Floats = np.zeros((len(xyz), 3), np.float32)
    clarity: Floats = np.zeros(len(xyz), np.float32)
    sharpness = 0.0
    if rgb is not None:
        rgb = at_resolution(rgb, view.inverse_depth.shape)
        light = to_linear(rgb[rows, columns])
        sharpness = sharpness_of(rgb)
        clarity = sharpness**_SHARP * view.cosine[rows, columns] ** _FRONTAL
    return Samples(xyz, normal, light, clarity, confidence, weight), sharpness


def back_project(
    camera: Intrinsics, camera_to_world: Floats, rows: Ints, columns: Ints, inverse: Floats, origin: Floats
) -> Floats:
    """Back-project pixels (N,) with inverse depth (N,) in 1/m to points (N,3) float32, relative to `origin` (3,)."""
    x, y = (columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy
    local = np.stack([x, y, np.ones_like(x)], axis=1, dtype=np.float32) / inverse[:, None]
    rotation = camera_to_world[:3, :3].astype(np.float32)
    xyz: Floats = local @ rotation.T + (camera_to_world[:3, 3] - origin).astype(np.float32)
    return xyz


def sharpness_of(rgb: Bytes) -> float:
    """Return the variance of the picture's Laplacian, in grey levels squared: blur lowers it by a factor of tens.

    It is comparable only between pictures of the same surface, such as a voxel averages.
    """
    import cv2

    grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    return max(float(cv2.Laplacian(grey, cv2.CV_32F).var()), _LEAST_SHARPNESS)


def at_resolution(rgb: Bytes, shape: tuple[int, ...]) -> Bytes:
    """Resize a picture (h,w,3) to the depth's (H,W); a depth pixel gets the mean colour of the area that it covers."""
    import cv2

    if rgb.shape[:2] == shape:
        return rgb
    shrink = rgb.shape[0] > shape[0]
    method = cv2.INTER_AREA if shrink else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(rgb, (shape[1], shape[0]), interpolation=method), np.uint8)
