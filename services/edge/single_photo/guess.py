"""One photo -> points all around the thing: a guess, and called one.

The photo is cut out and shown to the network, with and without a mirror. Each time it says 1,024 points; together they
are dense enough for a mesh, and where they contradict each other is where least is known.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from services.edge.arrays import Bools, Bytes, Floats, Ints, Tick
from services.edge.capture.nouns import Photo
from services.edge.guess.cutout import CutOut, cut_out, square
from services.edge.guess.looks import look
from services.edge.guess.pictures import FILL, SIDE, project
from services.edge.guess.weights import shipped_pixels

MOST_CONFIDENT = 0.2
"""Of 1: nobody measured anything."""
_AGREED = 0.05  # of the thing's radius: how far apart two looks put what both know
_STRAY = 0.2  # of the radius: what the others have so far away is dropped, but never more than half
_CELLS = 32  # per side, of the grid in which the nearest point hides those behind it
_HIDDEN = 0.12  # of the radius, behind the nearest in a cell


@dataclass(frozen=True, slots=True)
class Guess:
    """Points of a thing in a frame of its own: y up, the camera on the side of +z, the bounding box centred at 0, its
    longest side 1, which is called a metre because nobody knows better.

    xyz         (N,3) float64, N about 2,000
    rgb         (N,3) uint8 sRGB: of the pixel that shows the point, or of the nearest point that one shows
    confidence  (N,) float32 in [0, MOST_CONFIDENT]
    """

    xyz: Floats
    rgb: Bytes
    confidence: Floats


def guess(photo: Photo, *, tick: Tick) -> Guess:
    """Raises CaptureError CAPTURE_NO_OBJECT, and whatever loading the photo raises."""
    tick(0.0)
    cut = cut_out(photo)
    tick(0.6)
    picture = torch.from_numpy(square(cut, SIDE, FILL)).permute(2, 0, 1)[None]
    seen = look(shipped_pixels(), picture)
    tick(0.9)
    points = seen.points[0].numpy().astype(np.float64)
    apart = apart_from_others(points)
    xyz, keep = points.reshape(-1, 3), apart <= max(_STRAY, float(np.median(apart)))
    rgb = coloured(xyz, seen.camera, cut)
    low, high = xyz[keep].min(axis=0), xyz[keep].max(axis=0)
    xyz = (xyz[keep] - (low + high) / 2) / (high - low).max()
    confidence = (MOST_CONFIDENT * np.exp(-((apart[keep] / _AGREED) ** 2))).astype(np.float32)
    tick(1.0)
    return Guess(xyz, rgb[keep], confidence)


def apart_from_others(points: Floats) -> Floats:
    """(looks,n,3) -> (looks·n,): how far from each point the other looks' nearest ones are, on average."""
    trees = [cKDTree(each) for each in points]
    gaps = np.array([[tree.query(each)[0] for tree in trees] for each in points])
    mean: Floats = gaps.sum(axis=1) / (len(points) - 1)  # its own distance is 0
    return mean.reshape(-1)


def coloured(xyz: Floats, camera: Tensor, cut: CutOut) -> Bytes:
    """(n,3): what the photo shows where the camera sees a point; of a hidden point what the nearest seen one has."""
    at, depth = (each[0].numpy() for each in project(torch.from_numpy(xyz).float()[None], camera))
    rows, columns = np.nonzero(cut.mask)
    pixel = np.stack([_laid_over(at[:, 0], columns), _laid_over(-at[:, 1], rows)], axis=1)
    x, y = pixel.round().astype(int).T
    height, width = cut.mask.shape
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    x, y = x.clip(0, width - 1), y.clip(0, height - 1)
    # The outline's own pixels are half background.
    inner = cv2.erode(cut.mask.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(bool)
    seen = inside & inner[y, x] & _in_front(at, depth)
    if not seen.any():
        seen = np.ones(len(xyz), bool)
    rgb = cut.rgb[y, x]
    _, nearest = cKDTree(xyz[seen]).query(xyz)
    return np.asarray(np.where(seen[:, None], rgb, rgb[seen][nearest]), np.uint8)


def _laid_over(at: Floats, mask: Ints) -> Floats:
    """Stretched and moved so that they cover what the mask covers: the guessed camera is off by a few pixels."""
    low, high = np.percentile(at, (1, 99))
    first, last = np.percentile(mask, (0.5, 99.5))
    pixels: Floats = (at - low) / max(high - low, 1e-6) * (last - first) + first
    return pixels


def _in_front(at: Floats, depth: Floats) -> Bools:
    """Whether nothing hides a point: the nearest in its cell and in those around it."""
    cell = ((at + 1) / 2 * _CELLS).astype(int).clip(0, _CELLS - 1)
    first = np.full((_CELLS + 2, _CELLS + 2), np.inf)
    for right in (0, 1, 2):
        for down in (0, 1, 2):
            np.minimum.at(first, (cell[:, 0] + right, cell[:, 1] + down), depth)
    return np.asarray(depth < first[cell[:, 0] + 1, cell[:, 1] + 1] + _HIDDEN)
