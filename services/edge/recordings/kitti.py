"""Read photos in the layout of KITTI's odometry: `image_2/N.png`, `calib.txt`, and a table of poses.

A line "P2: ..." of calib.txt is the 3 x 4 projection of the camera whose pictures are in `image_2`, from the axes of
camera 0. A line of `poses.txt`, or of a file with the sequence's number as `00.txt`, is the 3 x 4 pose of camera 0, row
by row, in OpenCV axes and metres; there is one for each picture.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.files import Folder, data_lines, numbers, read_text
from capture2vr.edge.capture.frame_records import check_mostly_paired, checked_intrinsics, matrix_pinhole
from capture2vr.edge.capture.nouns import Capture, Photo
from capture2vr.edge.capture.photos import read_photo
from capture2vr.edge.capture.posed_photos import GivenCamera, posed_capture, with_camera
from capture2vr.sentences.sentence import say

_CALIBRATION = "calib.txt"
_CAMERAS = (2, 3, 0, 1)  # the coloured ones first
_POSES = re.compile(r"poses\.txt|\d\d\.txt")
_IMAGES = (".png", ".jpg", ".jpeg")


def matches(folder: Folder) -> bool:
    """Return whether there are calib.txt, a folder of pictures, and a table of poses."""
    return folder.has(_CALIBRATION) and _poses_file(folder) is not None and _camera(folder) is not None


def read(folder: Folder) -> Capture:
    """Read the photos of one camera with their poses. Raises CaptureError, naming the file."""
    camera, file = _camera(folder), _poses_file(folder)
    assert camera is not None
    assert file is not None
    names = folder.directly_in(f"image_{camera}", *_IMAGES)
    rows = data_lines(read_text(folder.path(file), file))
    both = min(len(names), len(rows))
    warnings = check_mostly_paired(
        both, len(names), len(rows), file=file, what=say("word_poses"), of=say("word_pictures")
    )
    matrix, offset = _projection(folder, camera)
    tries: list[Callable[[], Photo]] = [
        partial(_photo, folder, name, numbers(row.split(), 12, file=file, what="pose").reshape(3, 4), matrix, offset)
        for name, row in zip(names, rows, strict=False)
    ]
    return posed_capture("kitti", tries, scale="metric", warnings=warnings)


def _camera(folder: Folder) -> int | None:
    """Return the number of the first camera that has pictures."""
    return next((camera for camera in _CAMERAS if folder.directly_in(f"image_{camera}", *_IMAGES)), None)


def _poses_file(folder: Folder) -> str | None:
    return next((name for name in folder.directly_in("", ".txt") if _POSES.fullmatch(name)), None)


def _projection(folder: Folder, camera: int) -> tuple[Floats, Floats]:
    """Return the camera matrix (3,3), and where the camera is (3,) in the axes of camera 0."""
    text = read_text(folder.path(_CALIBRATION), _CALIBRATION)
    line = next((line for line in text.splitlines() if line.startswith(f"P{camera}:")), "")
    projection = numbers(line.split()[1:], 12, file=_CALIBRATION, what=f"P{camera}").reshape(3, 4)
    matrix = projection[:, :3]
    return matrix, -np.linalg.lstsq(matrix, projection[:, 3], rcond=None)[0]


def _photo(folder: Folder, name: str, pose: Floats, matrix: Floats, offset: Floats) -> Photo:
    photo = read_photo(folder, name)
    intrinsics = checked_intrinsics(matrix_pinhole(matrix, photo.size), name)
    moved = np.vstack([pose, [0, 0, 0, 1]])
    moved[:3, 3] += moved[:3, :3] @ offset
    return with_camera(photo, GivenCamera(name.split("/")[0], intrinsics, (0.0,) * 5, moved, "opencv"))
