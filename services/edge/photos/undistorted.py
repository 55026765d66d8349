"""Load photos for stereo: downscaled, undistorted, and grey, with their pinhole camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats
from capture2vr.edge.cameras.features import resize_mask
from capture2vr.edge.cameras.nouns import PhotoView
from capture2vr.edge.capture.nouns import Intrinsics

_REACH = 4.0
"""Pixels of a mask by which colours are continued beyond it: more than half a window of stereo at its resolution."""
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
    """Load a view's undistorted picture (H,W,3) uint8 sRGB, and its pinhole camera.

    Where a mask came with the photo, the object's colours go on beyond its outline.
    """
    rgb, photo = view.photo.load(longest), view.photo
    if photo.mask is not None and (photo.load_mask or photo.load_alpha):
        rgb = extend_colours(rgb, photo.mask)
    camera = view.intrinsics.scaled_to(rgb.shape[1], rgb.shape[0])
    return _undistort(rgb, view, camera), camera


def extend_colours(rgb: Bytes, mask: Bools) -> Bytes:
    """Continue the colours (H,W,3) inside a mask beyond its outline, which would else tint rims and windows across it.

    Transparent pixels are often black, and a mask's outline is not exact: its outermost pixel is replaced, too.
    """
    import cv2

    reach = _REACH * max(rgb.shape) / max(mask.shape)
    inner = resize_mask(cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool), rgb.shape[:2])
    side = 2 * int(np.ceil(reach)) + 1
    weight = cv2.blur(inner.astype(np.float32), (side, side))[..., None]
    mean = cv2.blur(np.where(inner[..., None], rgb, np.uint8(0)).astype(np.float32), (side, side))
    replaced = ~inner[..., None] & (weight * side**2 > 0.5)  # rounding leaves a little where no pixel is
    return np.where(replaced, mean / np.maximum(weight, 1e-6) + 0.5, rgb).astype(np.uint8)


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
