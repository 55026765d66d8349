"""Generate shapes: things of every class as coloured points on their surfaces. The same seed gives the same shapes.

Frame: y up; the camera's azimuth is 0, on the side of +z; the farthest point of the surface lies at distance 1. The
bounding box was centred at 0 before the thing was rotated.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn import functional

from tests.bench.single_photo_network.camera import about_vertical
from tests.bench.single_photo_training import clothes, furniture, household, vehicles
from tests.bench.single_photo_training.lofts import Dice

CLASSES: dict[str, Callable[[Dice], list[Tensor]]] = {
    "skirt": clothes.skirt,
    "t-shirt": clothes.tshirt,
    "dress": clothes.dress,
    "trousers": clothes.trousers,
    "chair": furniture.chair,
    "table": furniture.table,
    "sofa": furniture.sofa,
    "car": vehicles.car,
    "plane": vehicles.plane,
    "vessel": vehicles.vessel,
    "mug": household.mug,
    "bottle": household.bottle,
    "bowl": household.bowl,
    "banana": household.banana,
    "apple": household.apple,
    "lamp": furniture.lamp,
    "shoe": household.shoe,
    "box": furniture.case,
    "leaf": household.leaf,
    "vase": household.vase,
}
PAPER_CLASSES = tuple(CLASSES)[:10]
"""Classes of the published proof of concept, for comparison."""
SAMPLES = 12_000
"""Points on a surface: enough that a splat picture of 128 pixels has no holes worth mentioning."""


@dataclass(frozen=True, slots=True)
class Shapes:
    """n shapes of m points.

    xyz, normals, rgb (n,m,3) float32, colours in [0,1]; label (n,) index into CLASSES; yaw (n,) radians by which the
    thing is rotated from its own frame, whose front is on the side of +z.
    """

    xyz: Tensor
    normals: Tensor
    rgb: Tensor
    label: Tensor
    yaw: Tensor


def generate_shapes(seed: int, each: int, *, names: tuple[str, ...] = tuple(CLASSES), samples: int = SAMPLES) -> Shapes:
    """Generate `each` shapes of every named class."""
    generator = torch.Generator().manual_seed(seed)
    made = [_generate_class(name, each, samples, generator) for name in names]
    return Shapes(*(torch.cat(parts) for parts in zip(*made, strict=True)))


def _generate_class(name: str, n: int, samples: int, generator: torch.Generator) -> tuple[Tensor, ...]:
    """Generate n shapes of one class: the fields of `Shapes`, in their order."""
    dice = Dice(n, generator)
    grids = torch.stack(CLASSES[name](dice), dim=1)
    grids = grids * torch.cat([dice(0.8, 1.25) for _ in range(3)], dim=1)[:, None, None, None]
    own, normals, part, place = _sample_surface(grids, samples, generator)
    own, yaw = normalise(own), _yaw(n, generator)
    rgb = _paint(dice, part, place, own, grids.shape[1])
    label = torch.full((n,), list(CLASSES).index(name))
    return about_vertical(own, yaw), about_vertical(normals, yaw), rgb, label, yaw


def rotate_shapes(shapes: Shapes, seed: int) -> Shapes:
    """Rotate the shapes about the vertical by random angles."""
    more = _yaw(len(shapes.xyz), torch.Generator().manual_seed(seed))
    xyz, normals = (about_vertical(each, more) for each in (shapes.xyz, shapes.normals))
    return replace(shapes, xyz=xyz, normals=normals, yaw=shapes.yaw + more)


def _yaw(n: int, generator: torch.Generator) -> Tensor:
    """Random yaws (n,) in radians."""
    return 2 * math.pi * torch.rand(n, generator=generator)


def normalise(xyz: Tensor) -> Tensor:
    """Centre and scale points (n,m,3) into the frame of this file, before they are rotated."""
    xyz = xyz - (xyz.amin(dim=1, keepdim=True) + xyz.amax(dim=1, keepdim=True)) / 2
    scaled: Tensor = xyz / xyz.norm(dim=2).amax(dim=1)[:, None, None]
    return scaled


def _sample_surface(grids: Tensor, samples: int, generator: torch.Generator) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Sample uniformly by area -> points, normals (n,m,3), part number (n,m), place on the part (n,m,2) in [0,1]."""
    n, _, rings, around, _ = grids.shape
    a, b, c, d = grids[:, :, :-1, :-1], grids[:, :, 1:, :-1], grids[:, :, 1:, 1:], grids[:, :, :-1, 1:]
    corners = torch.stack([torch.stack([a, b, c], dim=-2), torch.stack([a, c, d], dim=-2)], dim=-3).reshape(n, -1, 3, 3)
    cross = torch.linalg.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
    share = cross.norm(dim=2).double().cumsum(dim=1)
    drawn = torch.rand(n, samples, generator=generator, dtype=torch.float64) * share[:, -1:]
    face = torch.searchsorted(share, drawn).clamp(max=share.shape[1] - 1)
    u, v = torch.rand(2, n, samples, 1, generator=generator)
    u, v = torch.where(u + v > 1, 1 - u, u), torch.where(u + v > 1, 1 - v, v)
    of = face[..., None, None].expand(-1, -1, 3, 3)
    p, q, r = corners.gather(1, of).unbind(dim=2)
    normals = functional.normalize(cross.gather(1, face[..., None].expand(-1, -1, 3)), dim=2)
    cell = face // 2
    per_part = (rings - 1) * (around - 1)
    place = torch.stack([cell % per_part // (around - 1) / (rings - 1), cell % (around - 1) / (around - 1)], dim=-1)
    return p + u * (q - p) + v * (r - p), normals, cell // per_part, place


def _paint(dice: Dice, part: Tensor, place: Tensor, xyz: Tensor, parts: int) -> Tensor:
    """Random colours (n,m,3): parts alike or not; stripes, checks or smooth waves on a share of the shapes."""
    n, g = dice.n, dice.generator
    base = torch.rand(n, 1, 3, generator=g) ** dice(0.4, 2.0)[..., None]
    apart = (dice.often(0.6) * dice(0.1, 1))[..., None]
    palette = base + apart * (torch.rand(n, parts, 3, generator=g) - base)
    rgb = palette.gather(1, part[..., None].expand(-1, -1, 3))
    other = torch.rand(n, 1, 3, generator=g)
    wave = torch.randn(n, 3, 2, generator=g) * dice(1, 12)[..., None]
    phase = 2 * math.pi * torch.rand(n, 1, 2, generator=g)
    waves = torch.sin(xyz @ wave + phase)
    stripes, checks = waves[..., :1], waves.prod(dim=2, keepdim=True)
    pattern = torch.where(dice.often(0.5)[..., None] > 0, stripes, checks)
    sharp = torch.where(dice.often(0.5)[..., None] > 0, pattern.sign(), pattern)
    amount = (dice.often(0.4) * dice(0.1, 0.5))[..., None] * (sharp + 1)
    rings = (torch.sin(place[..., :1] * (dice(3, 40)[..., None])) > 0).float() * (dice.often(0.15) * dice(0.1, 0.8))[
        ..., None
    ]
    mix = (amount + rings).clamp(0, 1)
    return (rgb * (1 - mix) + other * mix).clamp(0, 1)
