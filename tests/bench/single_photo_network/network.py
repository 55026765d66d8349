"""The network from a picture to points: the paper's "pixel-rearranged" one, and backbone of the other heads. Torch.

    (4,64,64) -> residual convolutions -> (192,4,4) -> 256 numbers -> (192,4,4)
              -> 3 x [convolution, PixelShuffle 2] -> (3,32,32) = 1,024 points on top of a base sphere

              -> rotated and moved to where the picture shows them (`refine.py`)

PixelShuffle moves channels into neighbouring pixels: neighbours in the square are made from the same numbers and tend
to be neighbours on the surface. The points are those of the thing with its front towards +z; a class of yaw says how
it is rotated.
The frame is that of `camera.py`: y up, the camera at azimuth 0 on the side of +z, the farthest point at 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn
from torch.nn import functional

from tests.bench.single_photo_network.camera import about_vertical
from tests.bench.single_photo_network.refine import Refine

WIDTHS = (32, 48, 96, 192)  # channels of the feature maps, the finest first
LATENT = 256  # numbers that describe the whole picture
GRID = 32  # points along each side of the square
POINTS = GRID * GRID
BINS = 36
"""Classes of the yaw, 10 degrees each: classes can say "front or back", where a number could only say "the side"."""


@dataclass(frozen=True, slots=True)
class Prediction:
    """The network's output for n pictures.

    own     (n,1024,3) points in the thing's own frame, its front towards +z; bins (n,BINS) logits of its yaw
    camera  (n,6) as in `camera.py`
    points  (n,1024,3) rotated by the likeliest yaw, and moved to where the picture shows them
    latent  (n,LATENT) code of the whole picture
    fine    (n,32,32,32), near (n,48,16,16) and wide (n,96,8,8): feature maps of the picture
    made    (n,32,32,32): feature map of the points
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
    """Residual block: two convolutions beside a skip connection (He et al. 2016); `stride` 2 halves the picture."""

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


class UpsamplingBlock(nn.Module):
    """Upsample by 2: a convolution, then four channels become a square of four pixels (Shi et al. 2016)."""

    def __init__(self, inner: int, outer: int) -> None:
        super().__init__()
        self.widen = nn.Conv2d(inner, 4 * outer, 3, 1, 1, bias=False)
        self.norm = nn.BatchNorm2d(outer)

    def forward(self, x: Tensor) -> Tensor:
        return functional.relu(self.norm(functional.pixel_shuffle(self.widen(x), 2)))


class Pixels(nn.Module):
    """The head `pixels`: n pictures (n,4,64,64) -> `Prediction`."""

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
        up = UpsamplingBlock
        self.rearrange = nn.Sequential(up(d, c), Block(c, c), up(c, b), Block(b, b), up(b, a))
        self.place = nn.Conv2d(a, 3, 3, 1, 1)
        nn.init.normal_(self.place.weight, std=1e-3)
        self.refine = Refine((a, b, c), a)
        self.register_buffer("sphere", base_sphere(), persistent=False)
        self.register_buffer("usual_camera", torch.tensor([0.35, 0.0, 0.25, 0.9, 0.0, 0.0]), persistent=False)

    def forward(self, picture: Tensor, yaw: Tensor | None = None) -> Prediction:
        """Predict points. yaw (n,): the radians by which the things are rotated; NaN, or None, takes the likeliest."""
        fine = self.stem(picture.contiguous(memory_format=torch.channels_last) - 0.5)
        near = self.to_near(fine)
        wide = self.to_wide(near)
        deep = self.to_all(wide)
        latent = functional.relu(self.squeeze(deep.flatten(1)))
        square = self.spread(latent).reshape(deep.shape) + deep
        made = self.rearrange(functional.relu(square))
        own = self.sphere + self.place(made).float().flatten(2).transpose(1, 2)
        bins, camera = self.bins(latent).float(), self.camera(latent).float() + self.usual_camera
        prediction = Prediction(own, bins, camera, own, latent, fine, near, wide, made)
        likely = likeliest_yaw(bins)
        turn = likely if yaw is None else torch.where(yaw.isnan(), likely, yaw)
        return replace(prediction, points=self.rotate_and_refine(prediction, picture, turn))

    def rotate_and_refine(self, prediction: Prediction, picture: Tensor, yaw: Tensor) -> Tensor:
        """Rotate the points by yaw (n,) radians, and move them to where the picture shows them -> (n,1024,3)."""
        maps = [prediction.fine, prediction.near, prediction.wide]
        rotated = about_vertical(prediction.own, yaw)
        points: Tensor = self.refine(rotated, prediction.camera, picture, maps, prediction.made)
        return points


def bin_of(yaw: Tensor) -> Tensor:
    """Number (n,) of the bin nearest to a yaw (n,) in radians."""
    return (yaw * BINS / (2 * math.pi)).round().long() % BINS


def likeliest_yaw(bins: Tensor) -> Tensor:
    """The most likely yaw (n,) in radians, from logits (n,BINS): interpolated in the likeliest three bins in a row."""
    share = bins.softmax(dim=1)
    before, after = share.roll(1, dims=1), share.roll(-1, dims=1)
    three = before + share + after
    best = three.argmax(dim=1, keepdim=True)
    between = (after - before).gather(1, best) / three.gather(1, best)
    return ((best + between) * 2 * math.pi / BINS)[:, 0]


def base_sphere() -> Tensor:
    """Points (1024,3) of a sphere of radius ½, in rows and columns: the octahedral map of a square."""
    axis = (torch.arange(GRID) + 0.5) / GRID * 2 - 1
    y, x = torch.meshgrid(axis, axis, indexing="ij")
    z = 1 - x.abs() - y.abs()
    over = (-z).clamp(min=0)
    xyz = torch.stack([x - x.sign() * over, y - y.sign() * over, z], dim=-1).reshape(-1, 3)
    return functional.normalize(xyz, dim=1) / 2
