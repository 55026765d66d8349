"""Test-time augmentation: predict points from several views of one picture, and combine them. Torch.

The network sees the picture as it is and shifted by a pixel, each also mirrored. All four views together decide the
yaw, and the outline that the points would have; the points are those of the two views that were not shifted: denser
than one view's, and as far apart as the views disagree.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from tests.bench.single_photo_network.camera import SIDE, about_vertical, project
from tests.bench.single_photo_network.network import BINS, Pixels

VIEWS = 2  # views whose points are used
_TRIED = 2 * BINS  # yaws that are compared
_CELLS = SIDE // 2  # per side of the grid in which outlines are compared: 1,024 points fill a thing's inside there
_OUTLINE = 5.0  # weight of a perfect outline, in logits; 10 and more are worse: outlines do not tell front from back
_DOUBT = 1e-3  # probability that is left to a yaw which the network rules out


@dataclass(frozen=True, slots=True)
class AugmentedPrediction:
    """points (n,VIEWS,1024,3) in the frame of `camera.py`, mirroring undone; camera (n,6) of the first view."""

    points: Tensor
    camera: Tensor


@torch.no_grad()
def predict_from_views(head: Pixels, picture: Tensor) -> AugmentedPrediction:
    """Predict points from pictures (n,4,64,64) by several views, which agree on one yaw."""
    shifted = picture.roll((1, 1), dims=(2, 3))
    views = [picture, picture.flip(3), shifted, shifted.flip(3)]
    predictions = [head(view) for view in views]
    plain, mirrored = predictions[:2]
    bins = [_mirror_bins(each.bins) if number % 2 else each.bins for number, each in enumerate(predictions)]
    yaw = _choose_yaw(plain.own, torch.stack(bins).log_softmax(dim=2).mean(dim=0), plain.camera, picture[:, 3])
    mirror = torch.tensor([-1.0, 1.0, 1.0])
    points = [
        head.rotate_and_refine(plain, views[0], yaw),
        head.rotate_and_refine(mirrored, views[1], -yaw) * mirror,
    ]
    return AugmentedPrediction(torch.stack(points, dim=1), plain.camera)


def _mirror_bins(bins: Tensor) -> Tensor:
    """Mirror the logits of the yaw (n,BINS): in a mirror a yaw is its negative."""
    return bins[:, (-torch.arange(BINS)) % BINS]


def _choose_yaw(own: Tensor, bins: Tensor, camera: Tensor, mask: Tensor) -> Tensor:
    """Choose the yaw (n,) that the network finds likely and under which the points cover the mask (n,64,64)."""
    share = bins.softmax(dim=1)
    three = share + (share.roll(1, dims=1) + share.roll(-1, dims=1)) / 2
    between = (three + three.roll(-1, dims=1)) / 2
    sure = (torch.stack([three, between], dim=2).flatten(1) + _DOUBT).log()
    small = functional.avg_pool2d(mask[:, None], SIDE // _CELLS)[:, 0] > 0.3  # thin things too
    yaws = torch.arange(_TRIED) * 2 * math.pi / _TRIED
    covered = torch.stack([_overlap(about_vertical(own, yaw.expand(len(own))), camera, small) for yaw in yaws], dim=1)
    return yaws[(sure + _OUTLINE * covered).argmax(dim=1)]


def _overlap(points: Tensor, camera: Tensor, mask: Tensor) -> Tensor:
    """Intersection over union (n,) of the points' outline and the mask (n,cells,cells).

    Both are brought to one middle and size first: the guessed camera is a few pixels off.
    """
    at, _ = project(points, camera)
    low, high = at.amin(dim=1), at.amax(dim=1)
    first, last = _bounds(mask)
    grow = (last - first).amax(dim=1) / (high - low).amax(dim=1).clamp(min=1e-6)
    at = (at - (low + high)[:, None] / 2) * torch.tensor([1.0, -1.0]) * grow[:, None, None]
    cell = (at + (first + last)[:, None] / 2).floor().long().clamp(0, _CELLS - 1)
    drawn = torch.zeros(len(points), _CELLS * _CELLS).scatter_(1, cell[..., 1] * _CELLS + cell[..., 0], 1.0)
    drawn = drawn.reshape(-1, 1, _CELLS, _CELLS)
    closed = -functional.max_pool2d(-functional.max_pool2d(drawn, 3, 1, 1), 3, 1, 1)[:, 0] > 0.5
    return (closed & mask).sum(dim=(1, 2)) / (closed | mask).sum(dim=(1, 2)).clamp(min=1)


def _bounds(mask: Tensor) -> tuple[Tensor, Tensor]:
    """Bounding box of a mask, in cells: left and top (n,2), right and bottom (n,2)."""
    number = torch.arange(mask.shape[1]).float()
    first, last = [], []
    for filled in (mask.any(dim=1), mask.any(dim=2)):
        first.append(torch.where(filled, number, number + mask.shape[1]).amin(dim=1))
        last.append(torch.where(filled, number + 1, 0 * number).amax(dim=1))
    return torch.stack(first, dim=1), torch.stack(last, dim=1)
