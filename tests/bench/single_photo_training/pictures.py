"""Render pictures of generated shapes: splats, random cameras and light, and the defects of real photos. Torch."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from tests.bench.single_photo_network.camera import FILL, SIDE, project
from tests.bench.single_photo_training.shapes import Shapes

_SUPER = 2  # supersampling of the splats: photos that were downsampled have soft edges too
_ELEVATION = (-10.0, 50.0)  # degrees: a phone held by a standing or kneeling person
_NOTHING = 4.0  # the depth of the background, behind everything: things reach from -1 to 1
_THROUGH = 0.1  # a pixel this much deeper than those around it sees through a hole between points
_NEAR, _FAR = 0.42, 0.08  # k of the camera: from a wide lens at arm's length to a camera far away


@dataclass(frozen=True, slots=True)
class RenderedPictures:
    """Rendered pictures (n,4,SIDE,SIDE): rgb times the mask, mask, in [0,1]; camera (n,6); row 0 is the top."""

    picture: Tensor
    camera: Tensor


def render_pictures(shapes: Shapes, seed: int, *, clean: bool = False) -> RenderedPictures:
    """Render one picture of each shape; `clean` leaves out the defects of photos and masks."""
    generator = torch.Generator().manual_seed(seed)
    camera = _frame(shapes.xyz, _cameras(len(shapes.xyz), generator), generator)
    rgb, mask = _splat(shapes, camera, _shade(shapes, camera, generator))
    return RenderedPictures(torch.cat([rgb, mask], dim=1) if clean else _add_defects(rgb, mask, generator), camera)


def _cameras(n: int, generator: torch.Generator) -> Tensor:
    """Random cameras (n,6), not yet zoomed."""
    drawn = torch.rand(n, 6, generator=generator)
    elevation = torch.deg2rad(_ELEVATION[0] + (_ELEVATION[1] - _ELEVATION[0]) * drawn[:, 0])
    roll = torch.deg2rad(12 * (drawn[:, 1] - 0.5))
    k = _FAR + (_NEAR - _FAR) * drawn[:, 2]
    return torch.stack([elevation, roll, k, torch.ones(n), torch.zeros(n), torch.zeros(n)], dim=1)


def _frame(xyz: Tensor, camera: Tensor, generator: torch.Generator) -> Tensor:
    """Zoom and shift cameras (n,6) so that the thing fills the frame about as in a cropped photo."""
    at, _ = project(xyz, camera)
    low, high = at.amin(dim=1), at.amax(dim=1)
    drawn = torch.rand(len(xyz), 3, generator=generator)
    s = 2 * (FILL + 0.12 * (drawn[:, :1] - 0.5)) / (high - low).amax(dim=1, keepdim=True)
    shift = 0.08 * (drawn[:, 1:] - 0.5) - s * (low + high) / 2
    return torch.cat([camera[:, :3], s, shift], dim=1)


def _shade(shapes: Shapes, camera: Tensor, generator: torch.Generator) -> Tensor:
    """Colours (n,m,3) under a lamp, ambient light and a gloss; both sides of a sheet are lit."""
    n = len(shapes.xyz)
    elevation = camera[:, 0]
    eye = torch.stack([0 * elevation, elevation.sin(), elevation.cos()], dim=1)
    facing = (shapes.normals @ eye[:, :, None]).sign()
    normal = shapes.normals * torch.where(facing == 0, 1.0, facing)
    lamp = torch.randn(n, 3, generator=generator) + torch.tensor([0.0, 1.0, 0.7])
    lamp = functional.normalize(lamp, dim=1)
    drawn = torch.rand(n, 3, 1, generator=generator)
    ambient = 0.25 + 0.5 * drawn[:, :1]
    sky = 1 + 0.25 * normal[..., 1:2]  # what faces up sees more light
    diffuse = (normal @ lamp[:, :, None]).clamp(min=0) * (1.1 - ambient)
    half = functional.normalize(lamp + eye, dim=1)[:, :, None]
    gloss = (normal @ half).clamp(min=0) ** 24 * (drawn[:, 1:2] - 0.5).clamp(min=0)
    return (shapes.rgb * (ambient * sky + diffuse) + gloss).clamp(0, 1)


def _splat(shapes: Shapes, camera: Tensor, rgb: Tensor) -> tuple[Tensor, Tensor]:
    """Draw the nearest point of each pixel -> colours times mask, mask. A point covers 2x2 of the fine pixels."""
    at, depth = project(shapes.xyz, camera)
    n, m = depth.shape
    side = SIDE * _SUPER
    x = ((at[..., 0] + 1) * side / 2 - 0.5).floor().long()
    y = ((1 - at[..., 1]) * side / 2 - 0.5).floor().long()
    # Depth and point in one integer: a minimum over it finds the nearest point, in any order of writing.
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
    # Pixels that see through between the points of a near surface do not count.
    valid = ((fine_depth < closed + _THROUGH) & (fine_depth < _NOTHING)).float()
    colour = colour.transpose(1, 2).reshape(n, 3, side, side) * valid
    mask = functional.avg_pool2d((closed < _NOTHING).float(), _SUPER)
    return _downsample(colour) / _downsample(valid).clamp(min=1e-6) * mask, mask


def _downsample(fine: Tensor) -> Tensor:
    """Average _SUPER² pixels, plus a little of those around them, for pixels of which none is valid."""
    return functional.avg_pool2d(fine, _SUPER) + 1e-3 * functional.avg_pool2d(fine, 3 * _SUPER, _SUPER, _SUPER)


def _add_defects(rgb: Tensor, mask: Tensor, generator: torch.Generator) -> Tensor:
    """Add the defects of real photos: background inside the mask, wrong masks, hidden parts, blur, tint and noise."""
    n = len(rgb)
    dice = torch.rand(n, 8, 1, 1, 1, generator=generator)
    tint = torch.rand(n, 3, 1, 1, generator=generator)
    behind = torch.rand(n, 3, 4, 4, generator=generator) * 0.3 + 0.7 * torch.rand(n, 3, 1, 1, generator=generator)
    full = rgb + (1 - mask) * functional.interpolate(behind, size=SIDE, mode="bilinear")
    full = torch.where(dice[:, 0] < 0.4, functional.avg_pool2d(full, 3, 1, 1, count_include_pad=False), full)
    full = (full * (0.6 + 0.7 * dice[:, 1]) * (0.85 + 0.3 * tint)).clamp(1e-3, 1) ** (0.6 + 0.8 * dice[:, 2])
    full = full + 0.06 * dice[:, 3] * torch.randn(full.shape, generator=generator)
    mask = _disturb_mask(mask, generator)
    return torch.cat([full.clamp(0, 1) * mask, mask], dim=1)


def _disturb_mask(mask: Tensor, generator: torch.Generator) -> Tensor:
    """Make the errors of GrabCut: a mask too wide or too narrow by a pixel or two, discs added or missing anywhere."""
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


def mirror_pictures(pictures: RenderedPictures) -> RenderedPictures:
    """Mirror pictures: they show the thing with x negated, to a camera that rolls the other way."""
    turned = torch.tensor([1.0, -1.0, 1.0, 1.0, -1.0, 1.0], device=pictures.camera.device)
    return RenderedPictures(pictures.picture.flip(3), pictures.camera * turned)
