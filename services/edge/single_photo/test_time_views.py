"""Several looks at one picture, and what they say together. Torch.

The picture is shown as it is, in a mirror, and moved by a pixel, each with and without the mirror. How the thing is
turned is said by all of them together and by the outline that the points would have; what it is like by the two that
were not moved: points of all four are denser, and as far apart as the looks disagree.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from services.edge.guess.network import BINS, Pixels
from services.edge.guess.pictures import SIDE, project
from services.edge.guess.shapes import about_vertical

LOOKS = 2  # whose points are taken
_TRIED = 2 * BINS  # yaws
_CELLS = SIDE // 2  # of the grid in which outlines are compared: 1,024 points fill a thing's inside there
_OUTLINE = 5.0  # how much a whole outline counts, in logits; 10 and more make it worse: outlines know no front
_DOUBT = 1e-3  # share that is left to a yaw which the network rules out


@dataclass(frozen=True, slots=True)
class Looks:
    """points (n,LOOKS,1024,3) in the frame of `shapes.py`, none mirrored any more; camera (n,6) of the first look."""

    points: Tensor
    camera: Tensor


@torch.no_grad()
def look(head: Pixels, picture: Tensor) -> Looks:
    """Pictures (n,4,64,64) -> points that agree about how the thing is turned."""
    moved = picture.roll((1, 1), dims=(2, 3))
    shown = [picture, picture.flip(3), moved, moved.flip(3)]
    seen = [head(each) for each in shown]
    bins = torch.stack([_mirrored(each.bins) if number % 2 else each.bins for number, each in enumerate(seen)])
    yaw = _turned(seen[0].own, bins.log_softmax(dim=2).mean(dim=0), seen[0].camera, picture[:, 3])
    mirror = torch.tensor([-1.0, 1.0, 1.0])
    points = [head.turned(seen[0], shown[0], yaw), head.turned(seen[1], shown[1], -yaw) * mirror]
    return Looks(torch.stack(points, dim=1), seen[0].camera)


def _mirrored(bins: Tensor) -> Tensor:
    """In a mirror a yaw is its negative."""
    return bins[:, (-torch.arange(BINS)) % BINS]


def _turned(own: Tensor, bins: Tensor, camera: Tensor, mask: Tensor) -> Tensor:
    """(n,) the yaw of which the network is sure and under which the points cover the mask (n,64,64)."""
    share = bins.softmax(dim=1)
    three = share + (share.roll(1, dims=1) + share.roll(-1, dims=1)) / 2
    between = (three + three.roll(-1, dims=1)) / 2
    sure = (torch.stack([three, between], dim=2).flatten(1) + _DOUBT).log()
    small = functional.avg_pool2d(mask[:, None], SIDE // _CELLS)[:, 0] > 0.3  # thin things too
    yaws = torch.arange(_TRIED) * 2 * math.pi / _TRIED
    covered = torch.stack([_overlap(about_vertical(own, yaw.expand(len(own))), camera, small) for yaw in yaws], dim=1)
    return yaws[(sure + _OUTLINE * covered).argmax(dim=1)]


def _overlap(points: Tensor, camera: Tensor, mask: Tensor) -> Tensor:
    """(n,) of the points' outline with the mask (n,cells,cells), over what both cover, laid middle on middle at one
    size: the guessed camera is a few pixels off."""
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
    """(n,2): left and top, and right and bottom, in cells."""
    number = torch.arange(mask.shape[1]).float()
    first, last = [], []
    for filled in (mask.any(dim=1), mask.any(dim=2)):
        first.append(torch.where(filled, number, number + mask.shape[1]).amin(dim=1))
        last.append(torch.where(filled, number + 1, 0 * number).amax(dim=1))
    return torch.stack(first, dim=1), torch.stack(last, dim=1)
