"""Picture -> points: the paper's "pixel-rearranged" network, read literally; the backbone of the other heads. Torch.

    (4,64,64) -> residual convolutions -> (192,4,4) -> 256 numbers -> (192,4,4)
              -> 3 x [convolution, PixelShuffle 2] -> (3,32,32) = 1,024 points on top of a base sphere

              -> turned to where the picture shows them and moved there (`refine.py`)

The rearranging moves channels into neighbouring pixels: what is near in the square is made from the same numbers and
tends to be near on the surface. The points say how the thing looks when its front is turned to +z, and a class of yaw
says how it is turned.
The frame is that of `shapes.py`: y up, the camera at azimuth 0 on the side of +z, the farthest point at 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn
from torch.nn import functional

from services.edge.guess.refine import Refine
from services.edge.guess.shapes import about_vertical

WIDTHS = (32, 48, 96, 192)
LATENT = 256
GRID = 32
POINTS = GRID * GRID
BINS = 36
"""Of the yaw, 10 degrees each: a class can say "the front or the back", where a number could only say "the side"."""


@dataclass(frozen=True, slots=True)
class Seen:
    """What the backbone makes of n pictures.

    own     (n,1024,3) points as if the thing's front were turned to +z; bins (n,BINS) logits of its yaw
    camera  (n,6) as in `pictures.py`
    points  (n,1024,3) turned by the likeliest yaw, and moved to where the picture shows them
    latent  (n,LATENT) of the whole picture
    fine    (n,32,32,32), near (n,48,16,16) and wide (n,96,8,8): features of its places
    made    (n,32,32,32): features of the points
    """

    own: Tensor
    bins: Tensor
    camera: Tensor
    points: Tensor
    latent: Tensor
    fine: Tensor
    near: Tensor
    wide: Tensor
    made: Tensor


class Block(nn.Module):
    """Two convolutions beside a straight way (He et al. 2016); `stride` 2 halves the picture."""

    def __init__(self, inner: int, outer: int, stride: int = 1) -> None:
        super().__init__()
        self.first = nn.Conv2d(inner, outer, 3, stride, 1, bias=False)
        self.second = nn.Conv2d(outer, outer, 3, 1, 1, bias=False)
        self.norm = nn.ModuleList([nn.BatchNorm2d(outer), nn.BatchNorm2d(outer)])
        self.straight = nn.Conv2d(inner, outer, 1, bias=False) if inner != outer else nn.Identity()
        self.stride = stride

    def forward(self, x: Tensor) -> Tensor:
        y = self.norm[1](self.second(functional.relu(self.norm[0](self.first(x)))))
        straight = functional.avg_pool2d(x, 2) if self.stride == 2 else x
        return functional.relu(y + self.straight(straight))


class Rearranged(nn.Module):
    """A convolution; then four channels become a square of four pixels (Shi et al. 2016)."""

    def __init__(self, inner: int, outer: int) -> None:
        super().__init__()
        self.widen = nn.Conv2d(inner, 4 * outer, 3, 1, 1, bias=False)
        self.norm = nn.BatchNorm2d(outer)

    def forward(self, x: Tensor) -> Tensor:
        return functional.relu(self.norm(functional.pixel_shuffle(self.widen(x), 2)))


class Pixels(nn.Module):
    """The head `pixels`: n pictures (n,4,64,64) -> `Seen`."""

    def __init__(self) -> None:
        super().__init__()
        a, b, c, d = WIDTHS
        self.stem = nn.Sequential(nn.Conv2d(4, a, 5, 2, 2, bias=False), nn.BatchNorm2d(a), nn.ReLU())
        self.to_near = nn.Sequential(Block(a, b, 2), Block(b, b))
        self.to_wide = nn.Sequential(Block(b, c, 2), Block(c, c))
        self.to_all = nn.Sequential(Block(c, d, 2), Block(d, d))
        self.squeeze = nn.Linear(d * 16, LATENT)
        self.camera = nn.Linear(LATENT, 6)
        self.bins = nn.Linear(LATENT, BINS)
        self.spread = nn.Linear(LATENT, d * 16)
        self.rearrange = nn.Sequential(Rearranged(d, c), Block(c, c), Rearranged(c, b), Block(b, b), Rearranged(b, a))
        self.place = nn.Conv2d(a, 3, 3, 1, 1)
        nn.init.normal_(self.place.weight, std=1e-3)
        self.refine = Refine((a, b, c), a)
        self.register_buffer("sphere", base_sphere(), persistent=False)
        self.register_buffer("usual_camera", torch.tensor([0.35, 0.0, 0.25, 0.9, 0.0, 0.0]), persistent=False)

    def forward(self, picture: Tensor, yaw: Tensor | None = None) -> Seen:
        """yaw (n,) radians by which things are turned; where it is NaN, and without it, the likeliest."""
        fine = self.stem(picture.contiguous(memory_format=torch.channels_last) - 0.5)
        near = self.to_near(fine)
        wide = self.to_wide(near)
        deep = self.to_all(wide)
        latent = functional.relu(self.squeeze(deep.flatten(1)))
        square = self.spread(latent).reshape(deep.shape) + deep
        made = self.rearrange(functional.relu(square))
        own = self.sphere + self.place(made).float().flatten(2).transpose(1, 2)
        bins, camera = self.bins(latent).float(), self.camera(latent).float() + self.usual_camera
        seen = Seen(own, bins, camera, own, latent, fine, near, wide, made)
        likely = likeliest(bins)
        turn = likely if yaw is None else torch.where(yaw.isnan(), likely, yaw)
        return replace(seen, points=self.turned(seen, picture, turn))

    def turned(self, seen: Seen, picture: Tensor, yaw: Tensor) -> Tensor:
        """(n,1024,3) as they are if the thing is turned by yaw (n,) radians, moved to where the picture shows them."""
        maps = [seen.fine, seen.near, seen.wide]
        points: Tensor = self.refine(about_vertical(seen.own, yaw), seen.camera, picture, maps, seen.made)
        return points


def bin_of(yaw: Tensor) -> Tensor:
    """(n,) radians -> the nearest bin's number."""
    return (yaw * BINS / (2 * math.pi)).round().long() % BINS


def likeliest(bins: Tensor) -> Tensor:
    """(n,BINS) logits -> (n,) radians: the likeliest three bins in a row, and where between them."""
    share = bins.softmax(dim=1)
    before, after = share.roll(1, dims=1), share.roll(-1, dims=1)
    three = before + share + after
    best = three.argmax(dim=1, keepdim=True)
    between = (after - before).gather(1, best) / three.gather(1, best)
    return ((best + between) * 2 * math.pi / BINS)[:, 0]


def base_sphere() -> Tensor:
    """(1024,3): a square folded into an octahedron and blown up to radius ½, rows and columns staying neighbours."""
    axis = (torch.arange(GRID) + 0.5) / GRID * 2 - 1
    y, x = torch.meshgrid(axis, axis, indexing="ij")
    z = 1 - x.abs() - y.abs()
    over = (-z).clamp(min=0)
    xyz = torch.stack([x - x.sign() * over, y - y.sign() * over, z], dim=-1).reshape(-1, 3)
    return functional.normalize(xyz, dim=1) / 2
