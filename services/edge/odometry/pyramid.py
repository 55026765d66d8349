"""A depth image and its picture at several resolutions, as alignment wants them: the plane and the shade of each pixel.

Symbols: q = inverse depth (1/m) of the pixel (u, v), whose ray is (x, y, 1); m = (∂q/∂x, ∂q/∂y, q - x·∂q/∂x - y·∂q/∂y)
is its plane, so that m·X = 1 for every X (3,) of the plane.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from services.edge.arrays import Bools, Floats
from services.edge.capture.nouns import Intrinsics
from services.edge.points.depth import max_jump, slopes

LEVELS = 3
_WINDOW_PX = 7
"""Side of the window over which slopes are averaged. Only tilts are: a pixel's own depth stays."""
_CALM_PX = 5
"""Side of the window that a picture's gradient has to itself on one surface."""


@dataclass(frozen=True)
class Level:
    """A depth image at one resolution: inverse_depth (H,W) float32 1/m, 0 unknown; grey (H,W) float32 0..1 or None."""

    camera: Intrinsics
    inverse_depth: Floats
    grey: Floats | None

    @property
    def rays(self) -> Floats:
        """(H·W,3) float32, of depth 1."""
        return _rays(self.camera)

    @cached_property
    def planes(self) -> Floats:
        """m (H·W,3) float32 of every pixel, zeros where unknown or at an edge."""
        q, camera = self.inverse_depth, self.camera
        dq_du, across = slopes(q, max_jump(camera, 0.0), axis=1)
        dq_dv, down = slopes(q, max_jump(camera, 0.0), axis=0)
        known = across & down & (q > 0)
        dx, dy = (_spread(slope, known).ravel() for slope in (dq_du * camera.fx, dq_dv * camera.fy))
        m = np.stack([dx, dy, q.ravel() - self.rays[:, 0] * dx - self.rays[:, 1] * dy], axis=1)
        return np.where(known.reshape(-1, 1), m, 0).astype(np.float32)

    @cached_property
    def calm(self) -> Bools:
        """(H·W,) whether the surface goes on around a pixel: at a silhouette two shades slide over each other."""
        import cv2

        q, window = self.inverse_depth, np.ones((_CALM_PX, _CALM_PX), np.uint8)
        near, far = cv2.dilate(q, window), cv2.erode(q, window)
        calm: Bools = (near - far < _CALM_PX * max_jump(self.camera, 0.0) * near).ravel()
        return calm

    @cached_property
    def gradient(self) -> Floats:
        """(H·W,3) float32: grey and its change per pixel along u and v."""
        assert self.grey is not None
        grey = np.pad(self.grey, 1, mode="edge")
        du, dv = (grey[1:-1, 2:] - grey[1:-1, :-2]) / 2, (grey[2:, 1:-1] - grey[:-2, 1:-1]) / 2
        return np.stack([self.grey, du, dv], axis=-1).reshape(-1, 3)

    def halved(self) -> Level:
        """Means of 2x2 pixels on one surface, the nearest of them where there are two: edges do not become slopes."""
        height, width = (side // 2 for side in self.inverse_depth.shape)
        blocks = _blocks(self.inverse_depth, height, width)
        near, far = blocks.max(axis=0), blocks.min(axis=0)
        c = self.camera
        camera = Intrinsics(c.fx / 2, c.fy / 2, (c.cx - 0.5) / 2, (c.cy - 0.5) / 2, width, height)
        one = near - far <= max_jump(c, 0.0) * near
        grey = None if self.grey is None else _blocks(self.grey, height, width).mean(axis=0)
        return Level(camera, np.where(one, blocks.mean(axis=0), near * (far > 0)), grey)


def pyramid(level: Level) -> tuple[Level, ...]:
    """From coarse to fine, `level` last."""
    levels = [level]
    while len(levels) < LEVELS:
        levels.append(levels[-1].halved())
    return tuple(reversed(levels))


def _spread(slope: Floats, known: Bools) -> Floats:
    """Means over windows of the known slopes: tilts that are noise would hold a camera that slides along a wall."""
    import cv2

    window = (_WINDOW_PX, _WINDOW_PX)
    total = cv2.blur(np.where(known, slope, 0).astype(np.float32), window)
    return np.asarray(total / np.maximum(cv2.blur(known.astype(np.float32), window), np.float32(1e-6)), np.float32)


@lru_cache(maxsize=LEVELS + 1)
def _rays(camera: Intrinsics) -> Floats:
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float32)
    return np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], -1).reshape(-1, 3)


def _blocks(image: Floats, height: int, width: int) -> Floats:
    even = image[: 2 * height, : 2 * width]
    return np.stack([even[i::2, j::2] for i in (0, 1) for j in (0, 1)])
