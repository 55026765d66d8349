"""Stray Scanner: `rgb.mp4`, `depth/`, `confidence/`, `odometry.csv`, `camera_matrix.csv`.

Depth is u16 PNG (older: .npy) in mm; the camera matrix holds for the video's size; poses are camera-to-world in OpenCV
axes in ARKit's world, Y against gravity. Phones without LiDAR leave depth out.
"""

from __future__ import annotations

import csv
import posixpath
from collections.abc import Mapping
from functools import partial

import numpy as np

from services.edge.arrays import Floats
from services.edge.capture.depth import confidence_image, depth_file
from services.edge.capture.files import Folder, numbers, read_text, reading, unreadable
from services.edge.capture.film import read_film
from services.edge.capture.nouns import Capture, Intrinsics, Photo
from services.edge.capture.posed import app_camera, posed_capture
from services.edge.capture.poses import bad_pose, pose_from_quaternion
from services.edge.capture.shots import Shot, matrix_pinhole, mostly_matched, no_poses, pinhole, rgbd_capture
from services.edge.capture.video import VideoColour, VideoFrames
from services.edge.errors import CaptureError

ODOMETRY, CAMERA, VIDEO = "odometry.csv", "camera_matrix.csv", "rgb.mp4"
METRES_PER_STEP = 1e-3
_VIDEO_SIZE = (1920, 1440)  # ARKit's, for a recording that lost its video
_UP_Y = np.array([0.0, 1.0, 0.0])


def matches(folder: Folder) -> bool:
    depth = folder.has_folder("depth") and (folder.has(ODOMETRY) or folder.has(CAMERA) or folder.has(VIDEO))
    return depth or (folder.has(ODOMETRY) and folder.has(VIDEO))


def read(folder: Folder) -> Capture:
    if not folder.has(ODOMETRY):
        raise no_poses("depth", ODOMETRY)
    rows = _odometry(folder)
    if not folder.has_folder("depth"):
        return _photos(folder, rows)
    depths = {_index(name): name for name in folder.directly_in("depth", ".png", ".npy")}
    posed = sorted(index for index in depths if index in rows)
    warnings = mostly_matched(len(posed), len(depths), len(rows), file=ODOMETRY, what="poses")
    video = VideoFrames(folder.path(VIDEO), VIDEO) if folder.has(VIDEO) else None
    if video is None:
        warnings = (*warnings, f"{VIDEO} is missing: no colours")
    size = video.size() if video is not None else _VIDEO_SIZE
    shared = None if "fx" in rows[posed[0]] else _matrix(folder, size)
    shots = [_shot(folder, index, depths[index], rows[index], shared, size, video) for index in posed]
    return rgbd_capture("stray", shots, axes="opencv", up=_UP_Y, file="depth", warnings=warnings)


def _photos(folder: Folder, rows: Mapping[int, Mapping[str, str]]) -> Capture:
    """The video's key frames with their poses."""
    film = read_film(folder, VIDEO)
    shared = None if "fx" in next(iter(rows.values())) else _matrix(folder, film.photos[0].size)
    frames = zip(film.photos, film.numbers, strict=True)
    tries = [partial(_photo, photo, index, rows.get(index), shared) for photo, index in frames]
    return posed_capture("stray", tries, scale="metric", up=_UP_Y, warnings=film.warnings)


def _photo(photo: Photo, index: int, row: Mapping[str, str] | None, shared: Intrinsics | None) -> Photo:
    if row is None:
        raise bad_pose(photo.name, f"is frame {index}, which {ODOMETRY} leaves out")
    return app_camera(photo, shared or _row_camera(row, photo.size), _pose(row, index), "opencv")


def _index(name: str) -> int:
    stem = posixpath.splitext(posixpath.basename(name))[0]
    if not (stem.isascii() and stem.isdigit() and len(stem) < 10):
        raise unreadable(name, "is not named by its frame's number")
    return int(stem)


def _odometry(folder: Folder) -> dict[int, Mapping[str, str]]:
    """Frame number -> its row."""
    text = read_text(folder.path(ODOMETRY), ODOMETRY)
    with reading(ODOMETRY, "CSV of poses"):
        table = csv.DictReader(text.splitlines(), skipinitialspace=True)
        rows = [{(key or "").strip(): value for key, value in row.items()} for row in table]
        found: dict[int, Mapping[str, str]] = {int(row["frame"]): row for row in rows}
    if not found:
        raise no_poses(ODOMETRY, "a row in odometry.csv")
    return found


def _shot(
    folder: Folder,
    index: int,
    depth: str,
    row: Mapping[str, str],
    shared: Intrinsics | None,
    size: tuple[int, int],
    video: VideoFrames | None,
) -> Shot:
    source = depth_file(folder.path(depth), depth, METRES_PER_STEP)
    confidence = f"confidence/{posixpath.splitext(posixpath.basename(depth))[0]}.png"
    load_confidence = partial(confidence_image, folder.path(confidence), confidence) if folder.has(confidence) else None
    colour = None if video is None else VideoColour(video, index, size)
    return Shot(depth, shared or _row_camera(row, size), _pose(row, index), source, load_confidence, colour)


def _pose(row: Mapping[str, str], index: int) -> Floats:
    """(4,4) camera-to-world."""
    words = [row.get(key) for key in ("x", "y", "z", "qx", "qy", "qz", "qw")]
    vector = numbers(words, 7, file=ODOMETRY, what=f"pose of frame {index}")
    return pose_from_quaternion(vector[:3], vector[3:])


def _row_camera(row: Mapping[str, str], size: tuple[int, int]) -> Intrinsics:
    """Newer versions write fx, fy, cx, cy of every frame."""
    words = numbers([row.get(key) for key in ("fx", "fy", "cx", "cy")], 4, file=ODOMETRY, what="intrinsics")
    return pinhole(words, size)


def _matrix(folder: Folder, size: tuple[int, int]) -> Intrinsics:
    if not folder.has(CAMERA):
        raise CaptureError("CAPTURE_BAD_INTRINSICS", f"{CAMERA} is missing", file=CAMERA)
    text = read_text(folder.path(CAMERA), CAMERA)
    k: Floats = numbers(text.replace(",", " ").split(), 9, file=CAMERA, what="camera matrix").reshape(3, 3)
    return matrix_pinhole(k, size)
