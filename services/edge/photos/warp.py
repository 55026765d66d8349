"""Warp a source picture to a reference view: by a plane (homography), or by a depth for every pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.photos.undistorted import UndistortedPhoto

_BEHIND = np.float32(1e-6)
"""Least depth that a point is projected with, over that of the ray's length."""


@dataclass(frozen=True, slots=True)
class Rays:
    """Rays of a pinhole camera: pixel (u, v) has the direction (x[u], y[v], 1); x (W,), y (H,)."""

    x: Floats
    y: Floats

    @classmethod
    def of(cls, picture: UndistortedPhoto) -> Rays:
        height, width = picture.grey.shape
        camera = picture.camera
        x = ((np.arange(width) - camera.cx) / camera.fx).astype(np.float32)
        y = ((np.arange(height) - camera.cy) / camera.fy).astype(np.float32)
        return cls(x, y)


@dataclass(frozen=True, slots=True)
class WarpSource:
    """A source picture and its projection: the reference's ray (x, y, 1) at inverse depth q projects to the source's
    pixel ~ turn·(x, y, 1) + q·shift, with turn = K R and shift = K t.

    turn (3,3), shift (3,); grey (H,W) float32; unproject (3,3): the reference's inverse camera matrix.
    """

    grey: Floats
    turn: Floats
    shift: Floats
    unproject: Floats

    @classmethod
    def of(cls, reference: UndistortedPhoto, source: UndistortedPhoto) -> WarpSource:
        relative = source.world_to_camera @ np.linalg.inv(reference.world_to_camera)
        k = source.k
        unproject = np.linalg.inv(reference.k)
        return cls(source.grey.astype(np.float32), k @ relative[:3, :3], k @ relative[:3, 3], unproject)

    def on_plane(self, q: float, shape: tuple[int, ...]) -> Floats:
        """Warp the picture to the reference, assuming that everything is on the plane at inverse depth q."""
        import cv2

        homography = self.turn @ self.unproject
        homography = homography + q * np.outer(self.shift, self.unproject[2])
        return np.asarray(
            cv2.warpPerspective(
                self.grey, homography, (shape[1], shape[0]), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
            )
        )

    def turned(self, rays: Rays) -> Floats:
        """Turn the reference's rays into the source: turn·(x, y, 1) of each pixel, (3,H,W) float32."""
        turn = self.turn.astype(np.float32)
        return np.stack([each[0] * rays.x[None] + (each[1] * rays.y + each[2])[:, None] for each in turn])

    def at(self, turned: Floats, q: Floats) -> Floats:
        """Warp the picture to the reference by the inverse depth q (H,W) of each pixel; turned (3,H,W): its rays."""
        import cv2

        u, v, w = (rays + shift * q for rays, shift in zip(turned, self.shift.astype(np.float32), strict=True))
        w = np.maximum(w, _BEHIND)  # points behind the source are far outside its picture
        return np.asarray(cv2.remap(self.grey, u / w, v / w, cv2.INTER_LINEAR))


def shift_px(rays: Rays, others: Sequence[WarpSource], q_far: float, q_near: float) -> float:
    """Return how far the picture's middle moves between two inverse depths, in pixels of the median source."""
    middle = np.array([rays.x[len(rays.x) // 2], rays.y[len(rays.y) // 2], 1.0])
    moved = []
    for other in others:
        far, near = (other.turn @ middle + q * other.shift for q in (q_far, q_near))
        moved.append(float(np.linalg.norm(near[:2] / near[2] - far[:2] / far[2])))
    return float(np.median(moved))
