"""Read Stray Scanner's recordings: `rgb.mp4`, `depth/`, `confidence/`, `odometry.csv`, `camera_matrix.csv`.

Depth is u16 PNG (older: .npy) in mm; the camera matrix is for the video's size; poses are camera-to-world in OpenCV
axes in ARKit's world, Y against gravity. Phones without LiDAR write no depth.
"""

from __future__ import annotations

import posixpath
from collections.abc import Mapping
from functools import partial

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.csv_rows import csv_rows
from capture2vr.edge.capture.depth import confidence_image, depth_file
from capture2vr.edge.capture.files import Folder, numbers, read_text, translate_errors, unreadable
from capture2vr.edge.capture.frame_records import (
    FrameRecord,
    check_mostly_paired,
    matrix_pinhole,
    no_poses,
    pinhole,
    rgbd_capture,
)
from capture2vr.edge.capture.nouns import Capture, Intrinsics, Photo
from capture2vr.edge.capture.posed_photos import posed_capture, with_app_camera
from capture2vr.edge.capture.poses import bad_pose, pose_from_quaternion
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.films.film import read_film
from capture2vr.edge.films.video import VideoColour, VideoFrames
from capture2vr.sentences.sentence import say

ODOMETRY, CAMERA, VIDEO = "odometry.csv", "camera_matrix.csv", "rgb.mp4"
METRES_PER_STEP = 1e-3
_VIDEO_SIZE = (1920, 1440)  # width and height of ARKit's video, for a recording whose video is missing
_UP_Y = np.array([0.0, 1.0, 0.0])


def matches(folder: Folder) -> bool:
    """Return whether the folder is a recording of Stray Scanner."""
    depth = folder.has_folder("depth") and (folder.has(ODOMETRY) or folder.has(CAMERA) or folder.has(VIDEO))
    return depth or (folder.has(ODOMETRY) and folder.has(VIDEO))


def read(folder: Folder) -> Capture:
    """Read the recording: RGB-D frames, or posed photos without depth. Raises CaptureError, naming the file."""
    if not folder.has(ODOMETRY):
        raise no_poses("depth", ODOMETRY)
    rows = _odometry(folder)
    if not folder.has_folder("depth"):
        return _photos(folder, rows)
    depths = {_frame_number(name): name for name in folder.directly_in("depth", ".png", ".npy")}
    posed = sorted(index for index in depths if index in rows)
    warnings = check_mostly_paired(len(posed), len(depths), len(rows), file=ODOMETRY, what=say("word_poses"))
    video = VideoFrames(folder.path(VIDEO), VIDEO) if folder.has(VIDEO) else None
    if video is None:
        warnings = (*warnings, say("missing_so_result", file=VIDEO))
    size = video.size() if video is not None else _VIDEO_SIZE
    shared = None if "fx" in rows[posed[0]] else _shared_intrinsics(folder, size)
    records = [_record(folder, index, depths[index], rows[index], shared, size, video) for index in posed]
    return rgbd_capture("stray", records, axes="opencv", up=_UP_Y, file="depth", warnings=warnings)


def _photos(folder: Folder, rows: Mapping[int, Mapping[str, str]]) -> Capture:
    """Read the video's key frames with their poses, as photos."""
    film = read_film(folder, VIDEO)
    shared = None if "fx" in next(iter(rows.values())) else _shared_intrinsics(folder, film.photos[0].size)
    frames = zip(film.photos, film.numbers, strict=True)
    tries = [partial(_photo, photo, index, rows.get(index), shared) for photo, index in frames]
    return posed_capture("stray", tries, scale="metric", up=_UP_Y, warnings=film.warnings)


def _photo(photo: Photo, index: int, row: Mapping[str, str] | None, shared: Intrinsics | None) -> Photo:
    if row is None:
        raise bad_pose(photo.name, say("frame_has_no_row", index=index, file=ODOMETRY))
    return with_app_camera(photo, shared or _row_camera(row, photo.size), _pose(row, index), "opencv")


def _frame_number(name: str) -> int:
    """Return the frame's number from the name of its depth file. Raises CAPTURE_UNREADABLE."""
    stem = posixpath.splitext(posixpath.basename(name))[0]
    if not (stem.isascii() and stem.isdigit() and len(stem) < 10):
        raise unreadable(name, say("has_name_not_frame_number"))
    return int(stem)


def _odometry(folder: Folder) -> dict[int, Mapping[str, str]]:
    """Read odometry.csv: frame number -> its row."""
    text = read_text(folder.path(ODOMETRY), ODOMETRY)
    with translate_errors(ODOMETRY, "CSV of poses"):
        found: dict[int, Mapping[str, str]] = {int(row["frame"]): row for row in csv_rows(text)}
    if not found:
        raise no_poses(ODOMETRY, "a row in odometry.csv")
    return found


def _record(
    folder: Folder,
    index: int,
    depth: str,
    row: Mapping[str, str],
    shared: Intrinsics | None,
    size: tuple[int, int],
    video: VideoFrames | None,
) -> FrameRecord:
    source = depth_file(folder.path(depth), depth, METRES_PER_STEP)
    confidence = f"confidence/{posixpath.splitext(posixpath.basename(depth))[0]}.png"
    load_confidence = partial(confidence_image, folder.path(confidence), confidence) if folder.has(confidence) else None
    colour = None if video is None else VideoColour(video, index, size)
    return FrameRecord(depth, shared or _row_camera(row, size), _pose(row, index), source, load_confidence, colour)


def _pose(row: Mapping[str, str], index: int) -> Floats:
    """Return the (4,4) camera-to-world pose of a row."""
    words = [row.get(key) for key in ("x", "y", "z", "qx", "qy", "qz", "qw")]
    vector = numbers(words, 7, file=ODOMETRY, what=f"pose of frame {index}")
    return pose_from_quaternion(vector[:3], vector[3:])


def _row_camera(row: Mapping[str, str], size: tuple[int, int]) -> Intrinsics:
    """Return the intrinsics in a row: newer versions of the app write fx, fy, cx, cy for every frame."""
    words = numbers([row.get(key) for key in ("fx", "fy", "cx", "cy")], 4, file=ODOMETRY, what="intrinsics")
    return pinhole(words, size)


def _shared_intrinsics(folder: Folder, size: tuple[int, int]) -> Intrinsics:
    """Read the intrinsics that all frames share, from camera_matrix.csv."""
    if not folder.has(CAMERA):
        what = say("missing_so_camera_intrinsics_unknown")
        raise CaptureError("CAPTURE_BAD_INTRINSICS", what, file=CAMERA, hints=(say("send_whole_recording"),))
    text = read_text(folder.path(CAMERA), CAMERA)
    k: Floats = numbers(text.replace(",", " ").split(), 9, file=CAMERA, what="camera matrix").reshape(3, 3)
    return matrix_pinhole(k, size)
