"""Guess points all around the thing in one photo. The result is marked as a guess.

The thing is cut out and shown to the network, as it is and mirrored. Each of these views gives 1,024 points, which are
densified to about 3,700; together they are dense enough for a mesh, and where the views disagree the confidence is low.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from capture2vr.edge.arrays import Bools, Bytes, Floats, Ints, Tick
from capture2vr.edge.capture.nouns import Photo
from capture2vr.edge.single_photo.camera import FILL, SIDE, project
from capture2vr.edge.single_photo.cutout import CutOut, crop_square, cut_out
from capture2vr.edge.single_photo.densify import densify
from capture2vr.edge.single_photo.prediction_views import predict_from_views
from capture2vr.edge.single_photo.weights import shipped_pixels
from capture2vr.order.photo_box import PhotoBox

MOST_CONFIDENT = 0.2
"""The highest confidence of a guessed point, of 1: nothing was measured."""
_AGREED = 0.05  # of the thing's radius: how far apart two views place a part that both know
_STRAY = 0.2  # of the radius: points farther from those of the other views are dropped, but never more than half
_CELLS = 32  # per side of the depth buffer, in which the nearest point hides those behind it
_HIDDEN = 0.12  # of the radius: how far behind the nearest of its cell a point is hidden


@dataclass(frozen=True, slots=True)
class Guess:
    """Points of a thing in a frame of its own: y up, the camera on the side of +z, the bounding box centred at 0, its
    longest side 1, which stands for a metre because the true size is unknown.

    xyz         (N,3) float64, N about 7,500
    rgb         (N,3) uint8 sRGB: of the pixel that shows the point, or of the nearest visible point
    confidence  (N,) float32 in [0, MOST_CONFIDENT]
    warnings    sentences on how the thing was cut out
    """

    xyz: Floats
    rgb: Bytes
    confidence: Floats
    warnings: tuple[str, ...] = ()


def guess(photo: Photo, *, box: PhotoBox | None = None, tick: Tick) -> Guess:
    """Guess the points of the thing in a photo, or in a rectangle of it.

    Raises CaptureError CAPTURE_NO_OBJECT, and whatever loading the photo raises.
    """
    tick(0.0)
    cut = cut_out(photo, box)
    tick(0.6)
    picture = torch.from_numpy(crop_square(cut, SIDE, FILL)).permute(2, 0, 1)[None]
    prediction = predict_from_views(shipped_pixels(), picture)
    tick(0.9)
    views = [densify(each) for each in prediction.points[0].numpy().astype(np.float64)]
    xyz, apart, keep = combine(views)
    rgb = sample_colours(xyz, prediction.camera, cut)
    low, high = xyz[keep].min(axis=0), xyz[keep].max(axis=0)
    xyz = (xyz[keep] - (low + high) / 2) / (high - low).max()
    confidence = (MOST_CONFIDENT * np.exp(-((apart[keep] / _AGREED) ** 2))).astype(np.float32)
    tick(1.0)
    return Guess(xyz, rgb[keep], confidence, cut.warnings)


def combine(views: Sequence[Floats]) -> tuple[Floats, Floats, Bools]:
    """Put views together: points (N,3), how far each is from those of the other views (N,), and which are no strays."""
    apart = disagreement(views)
    return np.concatenate(views), apart, apart <= max(_STRAY, float(np.median(apart)))


def disagreement(views: Sequence[Floats]) -> Floats:
    """Points (n,3) of every view -> (sum of n,) distance of each to the nearest of every other view, on average."""
    trees = [cKDTree(each) for each in views]
    summed = [sum(tree.query(each)[0] for tree in trees) for each in views]  # its own distance is 0
    return np.concatenate(summed) / (len(views) - 1)


def sample_colours(xyz: Floats, camera: Tensor, cut: CutOut) -> Bytes:
    """Colours (n,3) of points: the photo's where the camera sees the point, else those of the nearest visible point."""
    at, depth = (each[0].numpy() for each in project(torch.from_numpy(xyz).float()[None], camera))
    rows, columns = np.nonzero(cut.mask)
    pixel = np.stack([_fit_to_mask(at[:, 0], columns), _fit_to_mask(-at[:, 1], rows)], axis=1)
    x, y = pixel.round().astype(int).T
    height, width = cut.mask.shape
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    x, y = x.clip(0, width - 1), y.clip(0, height - 1)
    # Pixels on the outline are half background, so they give no colour.
    inner = cv2.erode(cut.mask.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(bool)
    visible = inside & inner[y, x] & _in_front(at, depth)
    if not visible.any():
        visible = np.ones(len(xyz), bool)
    rgb = cut.rgb[y, x]
    _, nearest = cKDTree(xyz[visible]).query(xyz)
    return np.asarray(np.where(visible[:, None], rgb, rgb[visible][nearest]), np.uint8)


def _fit_to_mask(at: Floats, mask: Ints) -> Floats:
    """Scale and shift coordinates to the range that the mask covers: the guessed camera is off by a few pixels."""
    low, high = np.percentile(at, (1, 99))
    first, last = np.percentile(mask, (0.5, 99.5))
    pixels: Floats = (at - low) / max(high - low, 1e-6) * (last - first) + first
    return pixels


def _in_front(at: Floats, depth: Floats) -> Bools:
    """Mask of the points that nothing hides: near the least depth of their cell and the cells around it."""
    cell = ((at + 1) / 2 * _CELLS).astype(int).clip(0, _CELLS - 1)
    first = np.full((_CELLS + 2, _CELLS + 2), np.inf)
    for right in (0, 1, 2):
        for down in (0, 1, 2):
            np.minimum.at(first, (cell[:, 0] + right, cell[:, 1] + down), depth)
    return np.asarray(depth < first[cell[:, 0] + 1, cell[:, 1] + 1] + _HIDDEN)
