"""Draw Gaussian splats as a camera sees them, so that the picture can be differentiated by every splat.

B. Kerbl et al., 3D Gaussian Splatting for Real-Time Radiance Field Rendering (2023). A splat with the covariance Σ,
seen through a camera with the rotation W, becomes an ellipse in the picture with the covariance
Σ' = J W Σ Wᵀ Jᵀ + 0.3 px², J being the projection's derivative at its centre (M. Zwicker et al., EWA Splatting, 2001).
Where it is drawn over a pixel at the offset d, it covers α = opacity · exp(−½ dᵀ Σ'⁻¹ d) of what is behind it:

colour = Σ_i T_i α_i c_i,  T_i = Π_{j before i} (1 − α_j)

One list holds every pair of a splat and a pixel that it covers, by pixel and from front to back, and the products are
differences of one running sum of logarithms: operations on whole arrays that PyTorch differentiates, on a CPU as on a
GPU. gsplat draws tiles with its own kernels, which need a CUDA compiler where they run, and no CPU can run them.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import torch
from torch import Tensor

from capture2vr.edge.render.posed_picture import PosedPicture
from capture2vr.edge.splats.surface_splats import Splats

_REACH = 3.0  # standard deviations of a splat that are drawn
_BLUR_PX2 = 0.3  # variance that is added to every splat, so that none falls between two pixels
_BESIDE = 0.15  # of the picture's sides: how far outside of it a splat's centre may be
_LEAST = 1 / 255  # opacity below which a pixel has nothing of a splat
_MOST = 0.99  # a splat never covers a pixel wholly: what is behind it would have no derivative
_HIDDEN = -7.0  # log T from which on splats are not drawn: a thousandth of the light is left


@dataclass(frozen=True, slots=True)
class SplatTensors:
    """N splats on one device, float32.

    xyz (N,3) metres; rotation (N,4) quaternions x, y, z, w of any length; scale (N,3) metres; opacity (N,) in [0,1];
    rgb (N,3) sRGB in [0,1]
    """

    xyz: Tensor
    rotation: Tensor
    scale: Tensor
    opacity: Tensor
    rgb: Tensor

    @classmethod
    def of(cls, splats: Splats, device: torch.device) -> SplatTensors:
        """Put splats on a device."""
        arrays = (splats.xyz, splats.rotation, splats.scale, splats.opacity, splats.rgb / 255)
        return cls(*(torch.tensor(each, dtype=torch.float32, device=device) for each in arrays))

    def take(self, which: Tensor) -> SplatTensors:
        """The splats with these numbers (M,)."""
        return SplatTensors(*(getattr(self, each.name).index_select(0, which) for each in fields(self)))


@dataclass(frozen=True, slots=True)
class PinholeView:
    """A camera with a picture of width x height pixels.

    to_camera (4,4) from the splats' frame to OpenCV axes; focal, middle (2,) in pixels, the picture's corner is at 0
    """

    to_camera: Tensor
    focal: Tensor
    middle: Tensor
    width: int
    height: int

    @classmethod
    def of(cls, picture: PosedPicture, width: int, height: int, device: torch.device) -> PinholeView:
        """The camera of a photo in that size."""
        size = np.array([width, height])
        to_camera, focal, middle = (
            torch.tensor(each, dtype=torch.float32, device=device)
            for each in (picture.to_camera, picture.focal * size, picture.middle * size)
        )
        return cls(to_camera, focal, middle, width, height)


@dataclass(frozen=True, slots=True)
class _Ellipses:
    """M splats in the picture, nearest first: at (M,2) pixels, precision (M,3) of xx, xy, yy, spread (M,2) pixels²."""

    at: Tensor
    precision: Tensor
    spread: Tensor
    opacity: Tensor
    rgb: Tensor


@dataclass(frozen=True, slots=True)
class _Pairs:
    """P pairs of a splat and a pixel that it covers, by pixel, nearest first.

    splat, pixel (P,) numbers; first (H·W,) the number of each pixel's first pair
    """

    splat: Tensor
    pixel: Tensor
    first: Tensor


def draw_splats(splats: SplatTensors, view: PinholeView) -> tuple[Tensor, Tensor]:
    """Return colours (H,W,3) over black, and how much of each pixel is covered (H,W) in [0,1]; differentiable."""
    ellipses = _project(splats, view)
    with torch.no_grad():
        pairs = _pairs(ellipses, view)
    alpha = _alpha(ellipses, pairs.splat, pairs.pixel, view)
    weight = (torch.exp(_log_light(alpha, pairs.pixel, pairs.first)).to(alpha.dtype) * alpha)[:, None]
    shown = torch.cat([weight * ellipses.rgb.index_select(0, pairs.splat), weight], dim=1)
    picture = shown.new_zeros(view.width * view.height, 4).index_add(0, pairs.pixel, shown)
    return picture[:, :3].reshape(view.height, view.width, 3), picture[:, 3].reshape(view.height, view.width)


def _project(splats: SplatTensors, view: PinholeView) -> _Ellipses:
    turn, shift = view.to_camera[:3, :3], view.to_camera[:3, 3]
    local = splats.xyz @ turn.T + shift
    with torch.no_grad():
        size = local.new_tensor([view.width, view.height])
        share = (local[:, :2] / local[:, 2:].clamp(min=1e-9) * view.focal + view.middle) / size
        # Farther outside the picture, and above all beside the camera, a plane is no likeness of the perspective.
        seen = torch.nonzero((local[:, 2] > 0) & ((share - 0.5).abs() < 0.5 + _BESIDE).all(dim=1))[:, 0]
        seen = seen[local[seen].norm(dim=1).argsort()]
    local, splats = local.index_select(0, seen), splats.take(seen)
    x, y, z = local.unbind(1)
    none, (fx, fy) = torch.zeros_like(z), view.focal
    slope = torch.stack([fx / z, none, -fx * x / z**2, none, fy / z, -fy * y / z**2], dim=1).reshape(-1, 2, 3)
    half = slope @ (turn @ (_matrices(splats.rotation) * splats.scale[:, None, :]))
    xx, yy = half.square().sum(dim=2).add(_BLUR_PX2).unbind(1)
    xy = (half[:, 0] * half[:, 1]).sum(dim=1)
    determinant = xx * yy - xy * xy
    return _Ellipses(
        torch.stack([x / z, y / z], dim=1) * view.focal + view.middle,
        torch.stack([yy, -xy, xx], dim=1) / determinant[:, None],
        torch.stack([xx, yy], dim=1).detach(),
        splats.opacity,
        splats.rgb,
    )


def _matrices(rotation: Tensor) -> Tensor:
    """Rotation matrices (N,3,3) of quaternions."""
    x, y, z, w = torch.nn.functional.normalize(rotation, dim=1).unbind(1)
    rows = [
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    ]
    return torch.stack(rows, dim=1).reshape(-1, 3, 3)


def _pairs(ellipses: _Ellipses, view: PinholeView) -> _Pairs:
    """Find the pairs that show: covered by more than nothing, and not behind what lets no light through."""
    device = ellipses.at.device
    size, reach = ellipses.at.new_tensor([view.width, view.height]), _REACH * ellipses.spread.sqrt()
    low = torch.minimum((ellipses.at - reach).floor().clamp(min=0), size).long()
    high = torch.minimum((ellipses.at + reach).ceil().clamp(min=0), size).long()
    wide, tall = (high - low).clamp(min=0).unbind(1)
    count = wide * tall
    splat = torch.repeat_interleave(torch.arange(len(count), device=device), count)
    place = torch.arange(len(splat), device=device) - torch.repeat_interleave(count.cumsum(0) - count, count)
    pixel = (place // wide[splat] + low[splat, 1]) * view.width + place % wide[splat] + low[splat, 0]
    alpha = _alpha(ellipses, splat, pixel, view)
    shown = torch.nonzero(alpha > _LEAST)[:, 0]
    # Splats are nearest first, and stay so within a pixel. Numbers of 32 bits are sorted in half the time.
    shown = shown[pixel[shown].to(torch.int32).sort(stable=True)[1]]
    splat, pixel = splat[shown], pixel[shown]
    lit = torch.nonzero(_log_light(alpha[shown], pixel, _firsts(pixel, view)) > _HIDDEN)[:, 0]
    return _Pairs(splat[lit], pixel[lit], _firsts(pixel[lit], view))


def _firsts(pixel: Tensor, view: PinholeView) -> Tensor:
    """Number of the first pair of each pixel (H·W,), of pairs (P,) that are sorted by pixel."""
    return torch.searchsorted(pixel, torch.arange(view.width * view.height, device=pixel.device))


def _log_light(alpha: Tensor, pixel: Tensor, first: Tensor) -> Tensor:
    """log T of each pair (P,) in double precision: differences of a sum that runs over all pixels."""
    log = torch.log1p(-alpha).double()
    before = log.cumsum(0) - log
    return before - before.index_select(0, first.index_select(0, pixel))


def _alpha(ellipses: _Ellipses, splat: Tensor, pixel: Tensor, view: PinholeView) -> Tensor:
    """How much of its pixel the splat of each pair covers (P,)."""
    shape = torch.cat([ellipses.at, ellipses.precision, ellipses.opacity[:, None]], dim=1)
    x, y, xx, xy, yy, opacity = shape.index_select(0, splat).unbind(1)
    dx = (pixel % view.width).to(x.dtype) + 0.5 - x
    dy = (pixel // view.width).to(x.dtype) + 0.5 - y
    return (opacity * torch.exp(-0.5 * (xx * dx * dx + 2 * xy * dx * dy + yy * dy * dy))).clamp(max=_MOST)
