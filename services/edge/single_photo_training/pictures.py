"""Pictures of generated shapes: splats seen by random cameras in random light, and what spoils a real photo. Torch.

A camera looks at the thing from azimuth 0, that is from +z. With x, y, z turned by its elevation and roll,

    u = s·x / (1 − k·z) + a,    v = s·y / (1 − k·z) + b         in [-1,1], u to the right, v up

where k is one over the distance in radii of the thing. Six numbers: elevation, roll (radians), k, s, a, b.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from services.edge.guess.shapes import Shapes

SIDE = 64
"""Pixels of what the network sees; the time of its training goes with their number."""
_SUPER = 2  # splats are drawn this much finer and averaged: photos that were shrunk have soft edges too
FILL = 0.88  # of the frame that the mask's longer side takes, on average and when a photo is cut out
_ELEVATION = (-10.0, 50.0)  # degrees: a phone held by a standing or kneeling person
_NOTHING = 4.0  # the depth of the background, behind everything: things reach from -1 to 1
_THROUGH = 0.1  # how much deeper than around it a pixel sees through a hole between points
_NEAR, _FAR = 0.42, 0.08  # k, from a wide lens at an arm's length to a far one


@dataclass(frozen=True, slots=True)
class Pictures:
    """picture (n,4,SIDE,SIDE): rgb times the mask, mask, in [0,1]; camera (n,6); row 0 is the top."""

    picture: Tensor
    camera: Tensor


def project(xyz: Tensor, camera: Tensor) -> tuple[Tensor, Tensor]:
    """(n,m,3) through (n,6) -> where in the picture (n,m,2), and depth (n,m), larger is farther."""
    elevation, roll, k, s = (camera[:, number, None] for number in range(4))
    x, y, z = xyz.unbind(dim=2)
    # A camera above looks down: the thing's top leans towards it.
    y, z = y * elevation.cos() - z * elevation.sin(), y * elevation.sin() + z * elevation.cos()
    x, y = x * roll.cos() - y * roll.sin(), x * roll.sin() + y * roll.cos()
    scale = s / (1 - k * z).clamp(min=0.2)  # a camera that a network guesses may be inside the thing
    return torch.stack([x * scale, y * scale], dim=2) + camera[:, None, 4:], -z


def photographed(shapes: Shapes, seed: int, *, clean: bool = False) -> Pictures:
    """One picture of each shape; `clean` leaves out what spoils photos and their masks."""
    generator = torch.Generator().manual_seed(seed)
    camera = _framed(shapes.xyz, _cameras(len(shapes.xyz), generator), generator)
    rgb, mask = _splat(shapes, camera, _lit(shapes, camera, generator))
    return Pictures(torch.cat([rgb, mask], dim=1) if clean else _spoilt(rgb, mask, generator), camera)


def _cameras(n: int, generator: torch.Generator) -> Tensor:
    drawn = torch.rand(n, 6, generator=generator)
    elevation = torch.deg2rad(_ELEVATION[0] + (_ELEVATION[1] - _ELEVATION[0]) * drawn[:, 0])
    roll = torch.deg2rad(12 * (drawn[:, 1] - 0.5))
    k = _FAR + (_NEAR - _FAR) * drawn[:, 2]
    return torch.stack([elevation, roll, k, torch.ones(n), torch.zeros(n), torch.zeros(n)], dim=1)


def _framed(xyz: Tensor, camera: Tensor, generator: torch.Generator) -> Tensor:
    """Zoomed and moved so that the thing fills the frame about as a cut-out photo does."""
    at, _ = project(xyz, camera)
    low, high = at.amin(dim=1), at.amax(dim=1)
    drawn = torch.rand(len(xyz), 3, generator=generator)
    s = 2 * (FILL + 0.12 * (drawn[:, :1] - 0.5)) / (high - low).amax(dim=1, keepdim=True)
    shift = 0.08 * (drawn[:, 1:] - 0.5) - s * (low + high) / 2
    return torch.cat([camera[:, :3], s, shift], dim=1)


def _lit(shapes: Shapes, camera: Tensor, generator: torch.Generator) -> Tensor:
    """(n,m,3) colours under one lamp, light from all around, and a gloss; both sides of a sheet are lit."""
    n = len(shapes.xyz)
    elevation = camera[:, 0]
    eye = torch.stack([0 * elevation, elevation.sin(), elevation.cos()], dim=1)
    facing = (shapes.normals @ eye[:, :, None]).sign()
    normal = shapes.normals * torch.where(facing == 0, 1.0, facing)
    lamp = torch.randn(n, 3, generator=generator) + torch.tensor([0.0, 1.0, 0.7])
    lamp = functional.normalize(lamp, dim=1)
    drawn = torch.rand(n, 3, 1, generator=generator)
    round_about = 0.25 + 0.5 * drawn[:, :1]
    sky = 1 + 0.25 * normal[..., 1:2]  # what faces up sees more light
    diffuse = (normal @ lamp[:, :, None]).clamp(min=0) * (1.1 - round_about)
    half = functional.normalize(lamp + eye, dim=1)[:, :, None]
    gloss = (normal @ half).clamp(min=0) ** 24 * (drawn[:, 1:2] - 0.5).clamp(min=0)
    return (shapes.rgb * (round_about * sky + diffuse) + gloss).clamp(0, 1)


def _splat(shapes: Shapes, camera: Tensor, rgb: Tensor) -> tuple[Tensor, Tensor]:
    """The nearest point of each pixel; every point covers 2x2 of the fine pixels. Colours are times the mask."""
    at, depth = project(shapes.xyz, camera)
    n, m = depth.shape
    side = SIDE * _SUPER
    x = ((at[..., 0] + 1) * side / 2 - 0.5).floor().long()
    y = ((1 - at[..., 1]) * side / 2 - 0.5).floor().long()
    # One integer that orders by depth and remembers the point: its minimum does not depend on the order of writing.
    key = ((depth + 2) * (1 << 20)).long() * m + torch.arange(m, device=depth.device)
    empty = 1 << 50
    nearest = torch.full((n, side * side + 1), empty, device=depth.device)
    for right in (0, 1):
        for down in (0, 1):
            column, row = x + right, y + down
            inside = (column >= 0) & (column < side) & (row >= 0) & (row < side)
            nearest.scatter_reduce_(1, torch.where(inside, row * side + column, side * side), key, "amin")
    nearest = nearest[:, :-1]
    point = torch.where(nearest < empty, nearest % m, 0)
    colour = rgb.gather(1, point[..., None].expand(-1, -1, 3))
    fine_depth = torch.where(nearest < empty, depth.gather(1, point), _NOTHING).reshape(n, 1, side, side)
    closed = functional.max_pool2d(-functional.max_pool2d(-fine_depth, 3, 1, 1), 3, 1, 1)
    # Between the points of a near surface shows what is behind it: such pixels do not count.
    seen = ((fine_depth < closed + _THROUGH) & (fine_depth < _NOTHING)).float()
    colour = colour.transpose(1, 2).reshape(n, 3, side, side) * seen
    mask = functional.avg_pool2d((closed < _NOTHING).float(), _SUPER)
    return _shrunk(colour) / _shrunk(seen).clamp(min=1e-6) * mask, mask


def _shrunk(fine: Tensor) -> Tensor:
    """Averages of _SUPER² pixels, and a little of those around them for where none of these counts."""
    return functional.avg_pool2d(fine, _SUPER) + 1e-3 * functional.avg_pool2d(fine, 3 * _SUPER, _SUPER, _SUPER)


def _spoilt(rgb: Tensor, mask: Tensor, generator: torch.Generator) -> Tensor:
    """A background that masks let through, masks too wide or too narrow, parts hidden, blur, tint and noise."""
    n = len(rgb)
    dice = torch.rand(n, 8, 1, 1, 1, generator=generator)
    tint = torch.rand(n, 3, 1, 1, generator=generator)
    behind = torch.rand(n, 3, 4, 4, generator=generator) * 0.3 + 0.7 * torch.rand(n, 3, 1, 1, generator=generator)
    full = rgb + (1 - mask) * functional.interpolate(behind, size=SIDE, mode="bilinear")
    full = torch.where(dice[:, 0] < 0.4, functional.avg_pool2d(full, 3, 1, 1, count_include_pad=False), full)
    full = (full * (0.6 + 0.7 * dice[:, 1]) * (0.85 + 0.3 * tint)).clamp(1e-3, 1) ** (0.6 + 0.8 * dice[:, 2])
    full = full + 0.06 * dice[:, 3] * torch.randn(full.shape, generator=generator)
    mask = _wrong(mask, generator)
    return torch.cat([full.clamp(0, 1) * mask, mask], dim=1)


def _wrong(mask: Tensor, generator: torch.Generator) -> Tensor:
    """What GrabCut gets wrong: a pixel or two more or less, and discs too many or too few at any place."""
    n = len(mask)
    kind = torch.rand(n, 1, 1, 1, generator=generator)
    wide = functional.max_pool2d(mask, 3, 1, 1)
    narrow = 1 - functional.max_pool2d(1 - mask, 3, 1, 1)
    mask = torch.where(kind < 0.25, wide, torch.where(kind > 0.85, narrow, mask))
    axis = torch.linspace(-1, 1, SIDE)
    drawn = torch.rand(n, 2, 5, 1, 1, generator=generator)
    for number, chance in enumerate((0.12, 0.12)):
        x, y, r, flat, luck = drawn[:, number].unbind(dim=1)
        gap = (axis[None, None, :] - 1.8 * (x - 0.5)) ** 2 + (
            (axis[None, :, None] - 1.8 * (y - 0.5)) * (1 + 2 * flat)
        ) ** 2
        disc = ((gap < (0.12 + 0.3 * r) ** 2) & (luck < chance))[:, None].float()
        mask = torch.maximum(mask, disc * 0.95) if number else mask * (1 - disc)
    return mask


def mirrored(pictures: Pictures) -> Pictures:
    """The picture in a mirror: that of the thing with x turned round, by a camera that rolls the other way."""
    turned = torch.tensor([1.0, -1.0, 1.0, 1.0, -1.0, 1.0], device=pictures.camera.device)
    return Pictures(pictures.picture.flip(3), pictures.camera * turned)
