"""Load photos for stereo: downscaled, undistorted, and grey, with their pinhole camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats
from capture2vr.edge.cameras.features import resize_mask
from capture2vr.edge.cameras.nouns import PhotoView
from capture2vr.edge.capture.nouns import Intrinsics

_NEGLIGIBLE_DISTORTION = 1e-6
"""Largest distortion coefficient that is ignored: less moves no pixel by a hundredth of a pixel."""


@dataclass(frozen=True, slots=True)
class UndistortedPhoto:
    """A view's undistorted grey picture with its pinhole camera.

    grey             (H,W) uint8, undistorted
    camera           of `grey`, a pinhole
    world_to_camera  (4,4) float64, OpenCV axes
    mask             (H,W) bool: True where `grey` may be used, or None for everywhere
    """

    view: PhotoView
    grey: Bytes
    camera: Intrinsics
    world_to_camera: Floats
    mask: Bools | None = None

    @property
    def k(self) -> Floats:
        """Camera matrix (3,3)."""
        return camera_matrix(self.camera)

    def half_size(self) -> UndistortedPhoto:
        """Downscale the picture and its camera to half the size; the mask is dropped."""
        import cv2

        height, width = self.grey.shape
        size = (max(1, width // 2), max(1, height // 2))
        grey = np.asarray(cv2.resize(self.grey, size, interpolation=cv2.INTER_AREA), np.uint8)
        return UndistortedPhoto(self.view, grey, self.camera.scaled_to(*size), self.world_to_camera)


def load_undistorted_grey(view: PhotoView, longest: int) -> UndistortedPhoto:
    """Load a view's grey picture, undistorted and downsampled to at most `longest` pixels."""
    import cv2

    rgb, camera = load_undistorted_rgb(view, longest)
    grey = np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), np.uint8)
    return UndistortedPhoto(view, grey, camera, np.linalg.inv(view.camera_to_world), _mask(view, camera))


def _mask(view: PhotoView, camera: Intrinsics) -> Bools | None:
    """Return the photo's mask at the camera's size, undistorted."""
    if view.photo.mask is None:
        return None
    mask = resize_mask(view.photo.mask, (camera.height, camera.width)).astype(np.uint8)
    return _undistort(mask, view, camera) > 0


def load_undistorted_rgb(view: PhotoView, longest: int) -> tuple[Bytes, Intrinsics]:
    """Load a view's undistorted picture (H,W,3) uint8 sRGB, and its pinhole camera."""
    rgb = view.photo.load(longest)
    camera = view.intrinsics.scaled_to(rgb.shape[1], rgb.shape[0])
    return _undistort(rgb, view, camera), camera


def _undistort(pixels: Bytes, view: PhotoView, camera: Intrinsics) -> Bytes:
    """Undistort a picture, keeping its camera matrix."""
    import cv2

    if max(map(abs, view.distortion)) <= _NEGLIGIBLE_DISTORTION:
        return pixels
    k = camera_matrix(camera)
    return np.asarray(cv2.undistort(pixels, k, np.asarray(view.distortion, np.float64), newCameraMatrix=k), np.uint8)


def camera_matrix(camera: Intrinsics) -> Floats:
    """Return the camera matrix (3,3) of a pinhole."""
    return np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], np.float64)
