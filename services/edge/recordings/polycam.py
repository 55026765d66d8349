"""Read Polycam's raw export: `keyframes/{corrected_images,corrected_cameras,depth,confidence}` and `mesh_info.json`.

Depth is u16 mm; poses are t_00 ... t_23, row-major camera-to-world in ARKit's axes and world, Y against gravity.
The corrected folders are bundle-adjusted and preferred to `images` and `cameras`. Phones without LiDAR write no depth.
"""

from __future__ import annotations

import posixpath
from dataclasses import replace
from functools import partial

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture import photos
from capture2vr.edge.capture.files import Folder, number, numbers, read_json, unreadable
from capture2vr.edge.capture.frame_records import (
    FrameRecord,
    check_mostly_paired,
    frame_of_files,
    image_dimensions,
    no_poses,
    rgbd_capture,
)
from capture2vr.edge.capture.nouns import Capture, Intrinsics, Photo
from capture2vr.edge.capture.posed_photos import posed_capture, with_app_camera
from capture2vr.sentences.sentence import say

METRES_PER_STEP = 1e-3
_POSE = [f"t_{row}{column}" for row in range(3) for column in range(4)]
_SIZE = (1024, 768)  # width and height of Polycam's key frames, for camera files without a size
_UP_Y = np.array([0.0, 1.0, 0.0])


def matches(folder: Folder) -> bool:
    """Return whether the folder is a raw export of Polycam."""
    return folder.has_folder("keyframes")


def read(folder: Folder) -> Capture:
    """Read the export: RGB-D frames, or photos without depth. Raises CaptureError, naming the file."""
    depths = _by_stem(folder, "depth")
    corrected = _by_stem(folder, "corrected_cameras")
    cameras = corrected or _by_stem(folder, "cameras")
    images = _by_stem(folder, "corrected_images" if corrected else "images")
    if not depths:
        return _photos(folder, images, cameras)
    if not cameras:
        raise no_poses("keyframes/depth", "keyframes/corrected_cameras")
    both = [stem for stem in depths if stem in cameras]
    warnings = check_mostly_paired(len(both), len(depths), len(cameras), file="keyframes", what=say("word_cameras"))
    confidences = _by_stem(folder, "confidence")
    records = [_record(folder, depths[stem], cameras[stem], images.get(stem), confidences.get(stem)) for stem in both]
    return rgbd_capture("polycam", records, axes="opengl", up=_UP_Y, file="keyframes/depth", warnings=warnings)


def _photos(folder: Folder, images: dict[str, str], cameras: dict[str, str]) -> Capture:
    """Read the images as photos, with their poses if the export has them."""
    if not cameras:
        images = _by_stem(folder, "corrected_images") or images
    if not images:
        raise unreadable("keyframes", say("has_neither_depth_nor_images"), say("send_whole_raw_export"))
    if not cameras:
        return photos.read(replace(folder, names=tuple(images.values())))
    both = [stem for stem in images if stem in cameras]
    warnings = check_mostly_paired(
        len(both), len(images), len(cameras), file="keyframes", what=say("word_cameras"), of=say("word_images")
    )
    tries = [partial(_photo, folder, images[stem], cameras[stem]) for stem in both]
    return posed_capture("polycam", tries, scale="metric", up=_UP_Y, warnings=warnings)


def _photo(folder: Folder, image: str, camera: str) -> Photo:
    return with_app_camera(photos.read_photo(folder, image), *_camera(folder, camera), "opengl")


def _by_stem(folder: Folder, part: str) -> dict[str, str]:
    """Return file name without folder and suffix -> path, for the files of one folder of `keyframes`."""
    names = folder.directly_in(f"keyframes/{part}")
    return {posixpath.splitext(posixpath.basename(name))[0]: name for name in names}


def _camera(folder: Folder, camera: str) -> tuple[Intrinsics, Floats]:
    """Read a camera file: the image's intrinsics, and the (3,4) camera-to-world pose."""
    record = read_json(folder.path(camera), camera)
    pose = numbers([record.get(key) for key in _POSE], 12, file=camera, what="t_00 ... t_23").reshape(3, 4)
    fx, fy, cx, cy = (number(record, key, file=camera) for key in ("fx", "fy", "cx", "cy"))
    sides = [number(record, key, file=camera) if key in record else side
             for key, side in zip(("width", "height"), _SIZE, strict=True)]  # fmt: skip
    return Intrinsics(fx, fy, cx, cy, *image_dimensions(sides[0], sides[1], camera)), pose


def _record(folder: Folder, depth: str, camera: str, image: str | None, confidence: str | None) -> FrameRecord:
    intrinsics, pose = _camera(folder, camera)
    return frame_of_files(folder, depth, intrinsics, pose, METRES_PER_STEP, colour=image, confidence=confidence)
