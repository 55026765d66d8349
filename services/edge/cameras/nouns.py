"""Data types of the result of structure from motion: posed `PhotoView`s and their shared sparse points."""

from __future__ import annotations

from dataclasses import dataclass

from capture2vr.edge.arrays import Floats, Ints
from capture2vr.edge.capture.nouns import Intrinsics, Photo, PhotoVerdict, PictureCamera


@dataclass(frozen=True, slots=True)
class PhotoView:
    """A photo with its camera intrinsics, lens distortion and pose.

    intrinsics       of the photo at its stored size, to be applied after the distortion
    distortion       OpenCV's (k1, k2, p1, p2, k3)
    camera_to_world  (4,4) float64, OpenCV axes, in units of the alignment
    """

    photo: Photo
    intrinsics: Intrinsics
    distortion: tuple[float, float, float, float, float]
    camera_to_world: Floats


def picture_camera(view: PhotoView) -> PictureCamera:
    """Return the camera of a photo as it is stored in the capture."""
    camera, pose = view.intrinsics, view.camera_to_world
    first, second, third = ((float(a), float(b), float(c), float(d)) for a, b, c, d in pose[:3])
    return PictureCamera(
        view.photo.name,
        (camera.width, camera.height),
        (float(camera.fx), float(camera.fy), float(camera.cx), float(camera.cy)),
        view.distortion,
        (first, second, third),
        view.photo.turns,
        view.photo.part,
    )


@dataclass(frozen=True, slots=True)
class Alignment:
    """Result of structure from motion: posed photos and sparse points.

    views        the photos that could be placed, in the order of the capture
    xyz          (P,3) float64 sparse points
    seen_point, seen_view  (T,) indices of the point and of the view of every observation
    error_px     mean reprojection error of the observations, in pixels of the pictures that features were found in
    verdicts     on every input photo, placed or not
    warnings     sentences for the report
    contradicted whether the poses that came with the photos contradict them, and were not used
    """

    views: tuple[PhotoView, ...]
    xyz: Floats
    seen_point: Ints
    seen_view: Ints
    error_px: float
    verdicts: tuple[PhotoVerdict, ...]
    warnings: tuple[str, ...] = ()
    contradicted: bool = False
