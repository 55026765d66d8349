"""The pictures that stereo works on: grey, of a common size, with the lens's distortion taken out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from services.edge.arrays import Bools, Bytes, Floats
from services.edge.capture.nouns import Intrinsics
from services.edge.photos.features import sized
from services.edge.photos.nouns import View

_STRAIGHT = 1e-6
"""Distortion coefficients below it move no pixel by a hundredth."""


@dataclass(frozen=True, slots=True)
class Picture:
    """A view as stereo sees it.

    grey             (H,W) uint8, undistorted
    camera           of `grey`, a pinhole
    world_to_camera  (4,4) float64, OpenCV axes
    mask             (H,W) of what of `grey` may be used, or None for all of it
    """

    view: View
    grey: Bytes
    camera: Intrinsics
    world_to_camera: Floats
    mask: Bools | None = None

    @property
    def k(self) -> Floats:
        """(3,3) camera matrix."""
        return matrix(self.camera)

    def halved(self) -> Picture:
        """The same at half the size."""
        import cv2

        height, width = self.grey.shape
        size = (max(1, width // 2), max(1, height // 2))
        grey = np.asarray(cv2.resize(self.grey, size, interpolation=cv2.INTER_AREA), np.uint8)
        return Picture(self.view, grey, self.camera.scaled_to(*size), self.world_to_camera)


def picture(view: View, longest: int) -> Picture:
    """Decode a view at no more than `longest` pixels along its longer side."""
    import cv2

    rgb, camera = colours(view, longest)
    grey = np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), np.uint8)
    return Picture(view, grey, camera, np.linalg.inv(view.camera_to_world), _mask(view, camera))


def _mask(view: View, camera: Intrinsics) -> Bools | None:
    """The photo's mask, undistorted."""
    if view.photo.mask is None:
        return None
    mask = sized(view.photo.mask, (camera.height, camera.width)).astype(np.uint8)
    return _straight(mask, view, camera) > 0


def colours(view: View, longest: int) -> tuple[Bytes, Intrinsics]:
    """(H,W,3) uint8 sRGB, undistorted, and its pinhole."""
    rgb = view.photo.load(longest)
    camera = view.intrinsics.scaled_to(rgb.shape[1], rgb.shape[0])
    return _straight(rgb, view, camera), camera


def _straight(pixels: Bytes, view: View, camera: Intrinsics) -> Bytes:
    """Without the lens's distortion."""
    import cv2

    if max(map(abs, view.distortion)) <= _STRAIGHT:
        return pixels
    k = matrix(camera)
    return np.asarray(cv2.undistort(pixels, k, np.asarray(view.distortion, np.float64), newCameraMatrix=k), np.uint8)


def matrix(camera: Intrinsics) -> Floats:
    """(3,3) of the pinhole."""
    return np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], np.float64)
