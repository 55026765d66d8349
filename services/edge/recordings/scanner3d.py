"""Read "all data" exports of 3D Scanner App: `frame_N.json`, `depth_N.png`, `conf_N.png`, `frame_N.jpg` of key frames.

Depth is u16 mm; `intrinsics` are 9 row-major at 1920 x 1440; `cameraPoseARFrame` is 16 row-major, camera-to-world in
ARKit's axes and world, Y against gravity. Phones without LiDAR write no depth.
"""

from __future__ import annotations

import re
from functools import partial

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.files import Folder, numbers, read_json
from capture2vr.edge.capture.frame_records import (
    FrameRecord,
    check_mostly_paired,
    frame_of_files,
    matrix_pinhole,
    no_poses,
    rgbd_capture,
)
from capture2vr.edge.capture.nouns import Capture, Intrinsics, Photo
from capture2vr.edge.capture.photos import read_photo
from capture2vr.edge.capture.posed_photos import posed_capture, with_app_camera
from capture2vr.sentences.sentence import say

METRES_PER_STEP = 1e-3
_SIZE = (1920, 1440)  # width and height in pixels that the intrinsics are for
_DEPTH, _FRAME, _IMAGE = r"depth_(\d+)\.(png|exr)", r"frame_(\d+)\.json", r"frame_(\d+)\.jpg"
_UP_Y = np.array([0.0, 1.0, 0.0])


def matches(folder: Folder) -> bool:
    """Return whether the folder is an export of 3D Scanner App."""
    return bool(_numbered(folder, _DEPTH) or (_numbered(folder, _FRAME) and _numbered(folder, _IMAGE)))


def read(folder: Folder) -> Capture:
    """Read the export: RGB-D frames, or posed photos without depth. Raises CaptureError, naming the file."""
    depths, frames, images = (_numbered(folder, pattern) for pattern in (_DEPTH, _FRAME, _IMAGE))
    if not depths:
        return _photos(folder, images, frames)
    if not frames:
        raise no_poses(next(iter(depths.values())), "frame_N.json")
    both = [index for index in depths if index in frames]
    # The app writes a JSON for every frame and depth for some, so only depth without a JSON is missing something.
    warnings = check_mostly_paired(
        len(both), len(depths), len(depths), file=next(iter(frames.values())), what=say("word_frames")
    )
    confidences = _numbered(folder, r"conf_(\d+)\.png")
    records = [
        _record(folder, depths[index], frames[index], images.get(index), confidences.get(index)) for index in both
    ]
    return rgbd_capture("3dscannerapp", records, axes="opengl", up=_UP_Y, file="depth", warnings=warnings)


def _photos(folder: Folder, images: dict[str, str], frames: dict[str, str]) -> Capture:
    """Read the key frames' images with their poses, as photos."""
    both = [index for index in images if index in frames]
    file = next(iter(frames.values()))
    warnings = check_mostly_paired(
        len(both), len(images), len(images), file=file, what=say("word_frames"), of=say("word_images")
    )
    tries = [partial(_photo, folder, images[index], frames[index]) for index in both]
    return posed_capture("3dscannerapp", tries, scale="metric", up=_UP_Y, warnings=warnings)


def _photo(folder: Folder, image: str, frame: str) -> Photo:
    return with_app_camera(read_photo(folder, image), *_camera(folder, frame), "opengl")


def _numbered(folder: Folder, pattern: str) -> dict[str, str]:
    """Return frame number, without leading zeros -> file name, for files that match the pattern."""
    found = ((re.fullmatch(pattern, name), name) for name in folder.directly_in(""))
    return {match[1].lstrip("0"): name for match, name in found if match}


def _camera(folder: Folder, frame: str) -> tuple[Intrinsics, Floats]:
    """Read a frame's JSON: the image's intrinsics, and the (4,4) camera-to-world pose."""
    record = read_json(folder.path(frame), frame)
    pose = numbers(record.get("cameraPoseARFrame"), 16, file=frame, what="cameraPoseARFrame").reshape(4, 4)
    k = numbers(record.get("intrinsics"), 9, file=frame, what="intrinsics").reshape(3, 3)
    return matrix_pinhole(k, _SIZE), pose


def _record(folder: Folder, depth: str, frame: str, image: str | None, confidence: str | None) -> FrameRecord:
    camera, pose = _camera(folder, frame)
    return frame_of_files(folder, depth, camera, pose, METRES_PER_STEP, colour=image, confidence=confidence)
