"""Refine the points guessed from the whole picture: move them to where the picture shows them. Torch.

    for each of two rounds:  p <- p + c(p, depth, the feature maps where p is seen, the features that made p)

with c convolutions over the square of points, whose neighbours are neighbours on the surface (features pooled at
projections as in Wang et al. 2018, Pixel2Mesh). Outlines and parts are precise in the picture, but were lost in the
few hundred numbers that the points were made from.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from tests.bench.single_photo_network.camera import project

_SHOWN = 32  # features of a place in the picture
_WIDE = 48  # channels inside a round
_SOFT = (4, 8)  # pixels over which the mask is averaged: the average tells how far a place is from the outline


class Refine(nn.Module):
    """The refining network. maps: channels of the feature maps, the finest first; own: features of every point."""

    def __init__(self, maps: tuple[int, ...], own: int) -> None:
        super().__init__()
        self.thin = nn.ModuleList([nn.Conv2d(channels, _SHOWN, 1, bias=False) for channels in maps])
        inner = own + 3 + 1 + 2 + 4 + len(_SOFT) + _SHOWN
        self.rounds = nn.ModuleList([_Round(inner), _Round(inner)])

    def forward(self, points: Tensor, camera: Tensor, picture: Tensor, maps: list[Tensor], own: Tensor) -> Tensor:
        """Move points (n,side²,3) in the picture's frame; picture (n,4,h,w); own (n,c,side,side) -> (n,side²,3)."""
        side, fine = own.shape[-1], maps[0].shape[-1]
        thin = [layer(each) for layer, each in zip(self.thin, maps, strict=True)]
        features = sum(functional.interpolate(each, size=fine, mode="bilinear") for each in thin[1:]) + thin[0]
        soft = [functional.avg_pool2d(picture[:, 3:], wide) for wide in _SOFT]
        for each in self.rounds:
            at, depth = project(points.detach(), camera.detach())
            where = (at * torch.tensor([1.0, -1.0], device=at.device)).reshape(len(at), side, side, 2)
            shown = [_sample(one, where) for one in (picture - 0.5, *soft, features)]
            place = torch.cat([points.detach(), depth[..., None], at], dim=2).transpose(1, 2)
            known = torch.cat([own, place.reshape(len(at), -1, side, side), *shown], dim=1)
            points = points + each(known).float().flatten(2).transpose(1, 2)
        return points


class _Round(nn.Module):
    """One round: features of every point (n,inner,side,side) -> its displacement (n,3,side,side)."""

    def __init__(self, inner: int) -> None:
        super().__init__()
        self.enter = nn.Conv2d(inner, _WIDE, 1, bias=False)
        self.beside = nn.Conv2d(_WIDE, _WIDE, 3, 1, 1, bias=False)
        self.norm = nn.ModuleList([nn.BatchNorm2d(_WIDE), nn.BatchNorm2d(_WIDE)])
        self.move = nn.Conv2d(_WIDE, 3, 1)
        nn.init.normal_(self.move.weight, std=1e-3)

    def forward(self, known: Tensor) -> Tensor:
        x = functional.relu(self.norm[0](self.enter(known.contiguous(memory_format=torch.channels_last))))
        moved: Tensor = self.move(x + functional.relu(self.norm[1](self.beside(x))))
        return moved


def _sample(maps: Tensor, where: Tensor) -> Tensor:
    """Sample maps (n,c,h,w) bilinearly at places (n,side,side,2) in [-1,1], x right and y down."""
    return functional.grid_sample(maps.float(), where, align_corners=False, padding_mode="border")
