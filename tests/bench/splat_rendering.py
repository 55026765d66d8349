"""Draw Gaussian splats as a camera sees them, on the CPU: B. Kerbl et al., 3D Gaussian Splatting (2023)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from services.edge.arrays import Bools, Floats, Ints
from services.edge.render.posed_picture import PosedPicture
from services.edge.splats.surface_splats import Splats

_BAND = 32  # rows of pixels that are drawn together: memory is that of the splats in them
_REACH = 3.0  # standard deviations of a splat that are drawn
_BLUR_PX2 = 0.3  # variance that is added to every splat, so that none falls between two pixels
_BESIDE = 0.15  # of the picture's sides: how far outside of it a splat's centre may be
_LEAST = 1 / 255  # opacity below which a pixel has nothing of a splat


@dataclass(frozen=True, slots=True)
class _Ellipses:
    """Splats in the picture, nearest first: at (N,2) pixels, precision (N,3) of xx, xy, yy, reach (N,2) in pixels."""

    at: Floats
    precision: Floats
    reach: Floats
    opacity: Floats
    rgb: Floats

    def take(self, which: Bools) -> _Ellipses:
        return _Ellipses(self.at[which], self.precision[which], self.reach[which], self.opacity[which], self.rgb[which])


def draw_splats(splats: Splats, picture: PosedPicture, width: int, height: int) -> tuple[Floats, Floats]:
    """Return colours (height,width,3), sRGB bytes as numbers over black, and opacity (height,width) in [0,1]."""
    ellipses = _project(splats, picture, width, height)
    rgb, opacity = np.zeros((height, width, 3), np.float32), np.zeros((height, width), np.float32)
    for top in range(0, height, _BAND):
        bottom = min(top + _BAND, height)
        low, high = ellipses.at[:, 1] - ellipses.reach[:, 1], ellipses.at[:, 1] + ellipses.reach[:, 1]
        _draw_band(ellipses.take((high >= top) & (low < bottom)), top, rgb[top:bottom], opacity[top:bottom])
    return rgb, opacity


def _project(splats: Splats, picture: PosedPicture, width: int, height: int) -> _Ellipses:
    places = splats.xyz.astype(np.float64)
    share, z = picture.project(places)
    local = places @ picture.to_camera[:3, :3].T + picture.to_camera[:3, 3]
    # Farther outside the picture, and above all beside the camera, a plane is no likeness of the perspective any more.
    seen = np.flatnonzero((z > 0) & (np.abs(share - 0.5) < 0.5 + _BESIDE).all(axis=1))
    order = seen[np.argsort(np.linalg.norm(local[seen], axis=1))]
    focal = picture.focal * [width, height]
    x, y, z = local[order].T
    slope = np.zeros((len(order), 2, 3))
    slope[:, 0, 0], slope[:, 0, 2] = focal[0] / z, -focal[0] * x / z**2
    slope[:, 1, 1], slope[:, 1, 2] = focal[1] / z, -focal[1] * y / z**2
    axes = Rotation.from_quat(splats.rotation[order]).as_matrix() * splats.scale[order][:, None, :]
    half = slope @ picture.to_camera[:3, :3] @ axes
    spread = half @ half.transpose(0, 2, 1) + np.eye(2) * _BLUR_PX2
    sure = np.linalg.inv(spread)
    return _Ellipses(
        share[order] * [width, height],
        np.stack([sure[:, 0, 0], sure[:, 0, 1], sure[:, 1, 1]], axis=1).astype(np.float32),
        _REACH * np.sqrt(np.stack([spread[:, 0, 0], spread[:, 1, 1]], axis=1)),
        splats.opacity[order],
        splats.rgb[order].astype(np.float32),
    )


def _draw_band(ellipses: _Ellipses, top: int, rgb: Floats, opacity: Floats) -> None:
    """Draw rows from `top` on into rgb (h,w,3) and opacity (h,w): what is nearer hides what is behind it."""
    height, width = opacity.shape
    splat, column, row = _pixels(ellipses, top, width, height)
    dx = (column + 0.5 - ellipses.at[splat, 0]).astype(np.float32)
    dy = (row + top + 0.5 - ellipses.at[splat, 1]).astype(np.float32)
    xx, xy, yy = ellipses.precision[splat].T
    alpha = ellipses.opacity[splat] * np.exp(-0.5 * (xx * dx * dx + 2 * xy * dx * dy + yy * dy * dy))
    shown = alpha > _LEAST
    splat, alpha, pixel = splat[shown], np.minimum(alpha[shown], 0.99), (row * width + column)[shown]
    order = np.argsort(pixel, kind="stable")  # splats are nearest first, and stay so within a pixel
    splat, alpha, pixel = splat[order], alpha[order].astype(np.float64), pixel[order]
    through = np.cumsum(np.log1p(-alpha)) - np.log1p(-alpha)  # before the splat, of all pixels so far
    begins = np.r_[True, pixel[1:] != pixel[:-1]] if len(pixel) else np.zeros(0, bool)
    through -= through[np.flatnonzero(begins)][np.cumsum(begins) - 1] if len(pixel) else 0
    weight = np.exp(through) * alpha
    for channel in range(3):
        seen = np.bincount(pixel, weight * ellipses.rgb[splat, channel], height * width)
        rgb[..., channel] = seen.reshape(height, width)
    opacity[...] = np.bincount(pixel, weight, height * width).reshape(height, width)


def _pixels(ellipses: _Ellipses, top: int, width: int, height: int) -> tuple[Ints, Ints, Ints]:
    """Pairs of a splat and a pixel in its reach: splats (P,), nearest first, columns (P,), rows (P,) of the band."""
    size = np.array([width, height])
    at = ellipses.at - [0, top]
    low = np.floor(at - ellipses.reach).clip(0, size).astype(np.int64)
    high = np.ceil(at + ellipses.reach).clip(0, size).astype(np.int64)
    wide, tall = np.maximum(high - low, 0).T
    count = wide * tall
    splat = np.repeat(np.arange(len(count)), count)
    place = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    row, column = np.divmod(place, np.maximum(wide, 1)[splat])
    return splat, column + low[splat, 0], row + low[splat, 1]
