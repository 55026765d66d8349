"""Read captures of nerfstudio, instant-ngp and NeRFCapture: `transforms.json`, images and, optionally, depth images.

Poses are camera-to-world in OpenGL axes. Pixel corners are at integers (COLMAP's convention), ours are pixel centres,
so half a pixel is subtracted from cx and cy.
"""

from __future__ import annotations

import math
import posixpath
from collections import ChainMap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.capture.depth import ColourSource, DepthSource, ImageColour, depth_file
from capture2vr.edge.capture.files import Folder, number, numbers, read_json, unreadable
from capture2vr.edge.capture.frame_records import (
    FrameRecord,
    checked_intrinsics,
    first_names,
    image_dimensions,
    missing_warning,
    rgbd_capture,
)
from capture2vr.edge.capture.images import has_8_bits, image_size, read_bytes
from capture2vr.edge.capture.listed_pictures import find_pictures
from capture2vr.edge.capture.masks import mask_loader
from capture2vr.edge.capture.nouns import Capture, Intrinsics, Photo
from capture2vr.edge.capture.photos import read_photo
from capture2vr.edge.capture.posed_photos import GivenCamera, posed_capture, unlisted_warning, with_camera
from capture2vr.edge.errors import CaptureError
from capture2vr.sentences.sentence import say

FILE = "transforms.json"
METRES_PER_STEP = 1e-3  # where the file has none of _DEPTH_UNITS: millimetres, as nerfstudio has it
_DEPTH_UNITS = ("depth_unit_scale_factor", "integer_depth_scale")  # metres per step: nerfstudio's, instant-ngp's
_NEGLIGIBLE_DISTORTION = (
    1e-6  # largest coefficient that is ignored: less distortion moves no pixel by a hundredth of a pixel
)
_DISTORTION = ("k1", "k2", "p1", "p2", "k3")  # in OpenCV's order
_MODELS = ("", "OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")

_Named = tuple[Mapping[str, Any], str]
"""A frame, and the name of its image."""


def matches(folder: Folder) -> bool:
    """Return whether the folder has a transforms.json."""
    return folder.has(FILE)


def read(folder: Folder) -> Capture:
    """Read the capture: RGB-D frames, or posed photos where there is no depth, or only 8-bit previews of it.

    Raises CaptureError, naming the file.
    """
    tree, frames = read_frames(folder, FILE)
    written = [(frame, path) for frame in frames if (path := _depth_path(frame)) is not None]
    if not written:
        return _photos(folder, tree, frames)
    present, missing = _split_present(folder, written, FILE)
    if not present:
        reason = say("lists_depth_images_but_capture", count=len(missing), name=first_names(missing[:1]))
        raise CaptureError("CAPTURE_COUNT_MISMATCH", reason, file=FILE, hints=(say("send_folder_depth_images"),))
    if _is_preview(folder, present[0][1]) and (capture := _photos_instead(folder, tree, frames, present[0][1])):
        return capture
    colours = find_pictures(folder, [frame["file_path"] for frame in frames if "file_path" in frame], by=FILE)
    records = [
        _record(folder, ChainMap(dict(frame), tree), depth, colours.get(str(frame.get("file_path"))))
        for frame, depth in present
    ]
    warnings = missing_warning(missing, say("word_depth_images"))
    return rgbd_capture("nerfstudio", records, axes="opengl", up=None, file=FILE, warnings=warnings)


def _frames(tree: Mapping[str, Any], file: str) -> list[dict[str, Any]]:
    frames = tree.get("frames")
    if not isinstance(frames, list) or not all(isinstance(frame, dict) for frame in frames):
        raise unreadable(file, say("has_no_list_objects_under"))
    if not frames:
        raise CaptureError("CAPTURE_EMPTY", say("has_empty_list_frames"), file=file)
    return frames


def _split_present(
    folder: Folder, written: Sequence[tuple[Mapping[str, Any], object]], file: str
) -> tuple[list[_Named], list[str]]:
    """Return the frames whose image is in the capture, and the paths of the other frames' images."""
    found = find_pictures(folder, [path for _, path in written], by=file)
    present = [(frame, found[str(path)]) for frame, path in written if str(path) in found]
    return present, [posixpath.normpath(str(path)) for _, path in written if str(path) not in found]


@dataclass(frozen=True, slots=True)
class ListedPhotos:
    """Photos that a file lists with their cameras.

    names    of those that are in the capture; tries: functions that read them, in the same order
    missing  paths of the others
    """

    names: list[str]
    tries: list[Callable[[], Photo]]
    missing: list[str]


def listed_photos(folder: Folder, tree: dict[str, Any], frames: Sequence[dict[str, Any]], file: str) -> ListedPhotos:
    """Find the photos of `frames` of the `tree` that `file` has. Raises CAPTURE_COUNT_MISMATCH where there is none."""
    pairs = [(ChainMap(frame, tree), frame.get("file_path")) for frame in frames]
    present, missing = _split_present(folder, pairs, file)
    if not present:
        reason = say("lists_images_but_capture", count=len(missing), name=first_names(missing[:1]))
        raise CaptureError("CAPTURE_COUNT_MISMATCH", reason, file=file, hints=(say("send_images"),))
    tries = [partial(_photo, folder, frame, name, file) for frame, name in present]
    return ListedPhotos([name for _, name in present], [*tries], missing)


def read_frames(folder: Folder, file: str) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Read a file of cameras: what it has for all frames, and the frames. Raises CAPTURE_UNREADABLE, CAPTURE_EMPTY."""
    tree = read_json(folder.path(file), file)
    return tree, _frames(tree, file)


def _photos(folder: Folder, tree: dict[str, Any], frames: Sequence[dict[str, Any]]) -> Capture:
    """Read the images as posed photos. The scale is unknown: it depends on the program that computed the poses."""
    listed = listed_photos(folder, tree, frames, FILE)
    depths = find_pictures(folder, filter(None, map(_depth_path, frames)), by=FILE).values()
    unlisted = unlisted_warning(folder, {*depths, *listed.names}, FILE)
    warnings = (*missing_warning(listed.missing, say("word_images")), *unlisted)
    return posed_capture("nerfstudio", listed.tries, warnings=warnings)


def _photo(folder: Folder, frame: Mapping[str, Any], name: str, file: str) -> Photo:
    photo = read_photo(folder, name)
    mask = frame.get("mask_path")
    if mask is not None and folder.has(at := folder.resolve(mask, by=file)):
        photo = replace(photo, load_mask=mask_loader(folder, at))
    camera = _camera(frame, lambda: photo.size, file)
    lens = _lens(frame, camera, file)
    pose = numbers(frame.get("transform_matrix"), 16, file=file, what=f"transform_matrix of {name}").reshape(4, 4)
    key = f"{camera.fx:.2f} {camera.cx:.2f} {camera.cy:.2f}"
    return with_camera(photo, GivenCamera(key, camera, lens.coefficients if lens else (0.0,) * 5, pose, "opengl"))


def _is_preview(folder: Folder, depth: str) -> bool:
    """Return whether a depth image has 8 bits, as NeRFCapture's: greys without a unit. False for an unreadable one."""
    if depth.lower().endswith(".npy"):
        return False
    try:
        return has_8_bits(read_bytes(folder.path(depth), depth), depth)
    except CaptureError:
        return False  # reported as every broken depth image is


def _photos_instead(
    folder: Folder, tree: dict[str, Any], frames: Sequence[dict[str, Any]], depth: str
) -> Capture | None:
    """Read the images as posed photos, with a warning that `depth` is a preview; None where there are no images."""
    pictured = [frame for frame in frames if frame.get("file_path")]
    if not find_pictures(folder, [frame["file_path"] for frame in pictured], by=FILE):
        return None
    capture = _photos(folder, tree, pictured)
    warning = say("depth_of_8_bits_ignored", file=depth)
    return replace(capture, warnings=(warning, *capture.warnings))


def _depth_path(frame: Mapping[str, Any]) -> object:
    return frame.get("depth_file_path") or frame.get("depth_path")


def _record(folder: Folder, frame: Mapping[str, Any], depth: str, colour: str | None) -> FrameRecord:
    """Read one frame. `frame` has the file's keys, overridden by the frame's: intrinsics may be in either place."""
    pose = numbers(frame.get("transform_matrix"), 16, file=FILE, what=f"transform_matrix of {depth}").reshape(4, 4)
    source = depth_file(folder.path(depth), depth, _metres_per_step(frame))
    measured = source.size if colour is None else partial(image_size, folder.path(colour), colour)
    camera = _camera(frame, measured, FILE)
    lens = _lens(frame, camera, FILE)
    rgb: ColourSource | None = None if colour is None else ImageColour(folder.path(colour), colour)
    if lens is not None:
        source, rgb = UndistortedDepth(source, lens), None if rgb is None else UndistortedColour(rgb, lens)
    return FrameRecord(depth, camera, pose, source, None, rgb)


def _metres_per_step(frame: Mapping[str, Any]) -> float:
    key = next((key for key in _DEPTH_UNITS if key in frame), None)
    scale = METRES_PER_STEP if key is None else number(frame, key, file=FILE)
    if not 0 < scale < math.inf:
        raise unreadable(FILE, say("has_not_positive_finite_number", key=key, value=scale))
    return scale


def _camera(frame: Mapping[str, Any], measured: Callable[[], tuple[int, int]], file: str) -> Intrinsics:
    """Return the intrinsics, for the image size in the file or else for the `measured` one."""
    if "w" in frame and "h" in frame:
        width, height = number(frame, "w", file=file), number(frame, "h", file=file)
    else:
        width, height = measured()
    size = image_dimensions(width, height, file)
    fx = _focal(frame, "x", width, file)
    fy = _focal(frame, "y", height, file) if "fl_y" in frame or "camera_angle_y" in frame else fx
    cx = number(frame, "cx", file=file) if "cx" in frame else width / 2
    cy = number(frame, "cy", file=file) if "cy" in frame else height / 2
    return checked_intrinsics(Intrinsics(fx, fy, cx - 0.5, cy - 0.5, *size), file)


def _focal(frame: Mapping[str, Any], axis: str, side: float, file: str) -> float:
    """Return the focal length in pixels, given as such or as the field of view: side = 2 f tan(angle / 2)."""
    if f"fl_{axis}" in frame:
        return number(frame, f"fl_{axis}", file=file)
    if f"camera_angle_{axis}" not in frame:
        what = say("has_neither_fl_nor_camera", x=axis, y=axis)
        raise CaptureError("CAPTURE_BAD_INTRINSICS", what, file=file)
    half = number(frame, f"camera_angle_{axis}", file=file) / 2
    return side / (2 * math.tan(half)) if 0 < half < math.pi / 2 else math.nan


@dataclass(frozen=True, slots=True)
class DistortedCamera:
    """A camera with lens distortion: OpenCV's coefficients (k1, k2, p1, p2, k3)."""

    camera: Intrinsics
    coefficients: tuple[float, ...]

    def undistort(self, image: Any, *, smooth: bool) -> Any:
        """Undistort an image, keeping the camera matrix; 0 where the original has no pixel.

        smooth: bilinear interpolation, else nearest. Depth needs nearest: a mean of front and back is a false point.
        """
        import cv2

        height, width = image.shape[:2]
        camera = self.camera.scaled_to(width, height)
        matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
        maps = cv2.initUndistortRectifyMap(
            matrix, np.array(self.coefficients), np.eye(3), matrix, (width, height), cv2.CV_32FC1
        )
        return cv2.remap(image, maps[0], maps[1], cv2.INTER_LINEAR if smooth else cv2.INTER_NEAREST)


def _lens(frame: Mapping[str, Any], camera: Intrinsics, file: str) -> DistortedCamera | None:
    """Return the camera with its distortion, or None without any. Raises CAPTURE_BAD_INTRINSICS."""
    if str(frame.get("camera_model", "")).upper() not in _MODELS or frame.get("is_fisheye"):
        what = say("has_camera_model_not_supported", model=repr(frame.get("camera_model", "fisheye")))
        raise CaptureError("CAPTURE_BAD_INTRINSICS", what, file=file, hints=(say("undistort_images_first"),))
    coefficients = tuple(number(frame, key, file=file) if key in frame else 0.0 for key in _DISTORTION)
    if not all(math.isfinite(value) for value in coefficients):
        raise CaptureError("CAPTURE_BAD_INTRINSICS", say("has_lens_distortion_coefficients"), file=file)
    return DistortedCamera(camera, coefficients) if max(map(abs, coefficients)) > _NEGLIGIBLE_DISTORTION else None


@dataclass(frozen=True, slots=True)
class UndistortedDepth:
    """The depth image of `source`, undistorted."""

    source: DepthSource
    lens: DistortedCamera

    @property
    def file(self) -> str:
        return self.source.file

    def size(self) -> tuple[int, int]:
        return self.source.size()

    def load(self) -> Floats:
        depth_m: Floats = self.lens.undistort(self.source.load(), smooth=False)
        return depth_m


@dataclass(frozen=True, slots=True)
class UndistortedColour:
    """The colour image of `source`, undistorted."""

    source: ColourSource
    lens: DistortedCamera

    @property
    def file(self) -> str:
        return self.source.file

    def size(self) -> tuple[int, int]:
        return self.source.size()

    def load(self) -> Bytes:
        rgb: Bytes = self.lens.undistort(self.source.load(), smooth=True)
        return rgb
