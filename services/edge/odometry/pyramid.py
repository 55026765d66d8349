"""Image pyramids for alignment: a depth image and its grey picture at several resolutions, and each pixel's plane.

Symbols: q = inverse depth (1/m) of the pixel (u, v), whose ray is (x, y, 1); m = (∂q/∂x, ∂q/∂y, q - x·∂q/∂x - y·∂q/∂y)
is its plane, so that m·X = 1 for every X (3,) of the plane.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from capture2vr.edge.arrays import Bools, Floats
from capture2vr.edge.capture.nouns import Intrinsics
from capture2vr.edge.points.depth_limits import max_jump, slopes

LEVELS = 3
"""Resolutions of a pyramid, each half of the next."""
_WINDOW_PX = 7
"""Side of the window over which slopes are averaged; the depth itself is not averaged."""
_CALM_PX = 5
"""Side of the window that must be on one surface for the picture's gradient in its centre to be used."""


@dataclass(frozen=True)
class PyramidLevel:
    """One level of a pyramid: inverse_depth (H,W) float32 1/m, 0 unknown; grey (H,W) float32 0..1 or None."""

    camera: Intrinsics
    inverse_depth: Floats
    grey: Floats | None

    @property
    def rays(self) -> Floats:
        """Rays (H·W,3) float32 of the pixels, at depth 1."""
        return _rays(self.camera)

    @cached_property
    def planes(self) -> Floats:
        """Planes m (H·W,3) float32 of the pixels, zeros where unknown or at a depth edge."""
        q, camera = self.inverse_depth, self.camera
        dq_du, across = slopes(q, max_jump(camera, 0.0), axis=1)
        dq_dv, down = slopes(q, max_jump(camera, 0.0), axis=0)
        known = across & down & (q > 0)
        dx, dy = (_smooth_slopes(slope, known).ravel() for slope in (dq_du * camera.fx, dq_dv * camera.fy))
        m = np.stack([dx, dy, q.ravel() - self.rays[:, 0] * dx - self.rays[:, 1] * dy], axis=1)
        return np.where(known.reshape(-1, 1), m, 0).astype(np.float32)

    @cached_property
    def off_edges(self) -> Bools:
        """Mask (H·W,): True for pixels away from depth edges; across an edge the shades of two surfaces mix."""
        import cv2

        q, window = self.inverse_depth, np.ones((_CALM_PX, _CALM_PX), np.uint8)
        near, far = cv2.dilate(q, window), cv2.erode(q, window)
        off_edges: Bools = (near - far < _CALM_PX * max_jump(self.camera, 0.0) * near).ravel()
        return off_edges

    @cached_property
    def gradient(self) -> Floats:
        """Grey and its change per pixel along u and v: (H·W,3) float32."""
        assert self.grey is not None
        grey = np.pad(self.grey, 1, mode="edge")
        du, dv = (grey[1:-1, 2:] - grey[1:-1, :-2]) / 2, (grey[2:, 1:-1] - grey[:-2, 1:-1]) / 2
        return np.stack([self.grey, du, dv], axis=-1).reshape(-1, 3)

    def half_size(self) -> PyramidLevel:
        """Downsample by 2: the mean of 2x2 pixels on one surface, or at a depth edge the nearest pixel.

        Averaging across an edge would make a slope of it."""
        height, width = (side // 2 for side in self.inverse_depth.shape)
        blocks = _blocks(self.inverse_depth, height, width)
        near, far = blocks.max(axis=0), blocks.min(axis=0)
        c = self.camera
        camera = Intrinsics(c.fx / 2, c.fy / 2, (c.cx - 0.5) / 2, (c.cy - 0.5) / 2, width, height)
        one = near - far <= max_jump(c, 0.0) * near
        grey = None if self.grey is None else _blocks(self.grey, height, width).mean(axis=0)
        return PyramidLevel(camera, np.where(one, blocks.mean(axis=0), near * (far > 0)), grey)


@dataclass(frozen=True, slots=True)
class PackedLevel:
    """A level to be kept: 300 kB at 320 x 240. Half precision rounds depth to 0.02 %, a fifth of what the best sensor
    errs by, and grey to a tenth of a level.

    inverse_depth (H,W) float16 1/m, 0 where unknown; grey (H,W) float16 0..1 or None
    """

    camera: Intrinsics
    inverse_depth: Floats
    grey: Floats | None

    @classmethod
    def of(cls, level: PyramidLevel) -> PackedLevel:
        """Pack a level, without what it has cached."""
        grey = None if level.grey is None else level.grey.astype(np.float16)
        return cls(level.camera, level.inverse_depth.astype(np.float16), grey)

    def unpacked(self) -> PyramidLevel:
        """Return the level."""
        grey = None if self.grey is None else self.grey.astype(np.float32)
        return PyramidLevel(self.camera, self.inverse_depth.astype(np.float32), grey)


def pyramid(level: PyramidLevel) -> tuple[PyramidLevel, ...]:
    """Build the pyramid of a level: from coarse to fine, `level` last."""
    levels = [level]
    while len(levels) < LEVELS:
        levels.append(levels[-1].half_size())
    return tuple(reversed(levels))


def _smooth_slopes(slope: Floats, known: Bools) -> Floats:
    """Average the known slopes over windows.

    Noisy slopes would falsely constrain a camera that can slide along a wall."""
    import cv2

    window = (_WINDOW_PX, _WINDOW_PX)
    total = cv2.blur(np.where(known, slope, 0).astype(np.float32), window)
    return np.asarray(total / np.maximum(cv2.blur(known.astype(np.float32), window), np.float32(1e-6)), np.float32)


@lru_cache(maxsize=LEVELS + 1)
def _rays(camera: Intrinsics) -> Floats:
    """Return the rays (H·W,3) float32 of a camera, at depth 1; cached."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float32)
    return np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], -1).reshape(-1, 3)


def _blocks(image: Floats, height: int, width: int) -> Floats:
    """Return the four pixels of each 2x2 block, (4,height,width)."""
    even = image[: 2 * height, : 2 * width]
    return np.stack([even[i::2, j::2] for i in (0, 1) for j in (0, 1)])
