"""Depth and colour folders with a trajectory: Open3D's `trajectory.log`, or TUM's `groundtruth.txt` with time stamps.
Without one the frames have no poses, and are in the order of their names or time stamps.

Poses are camera-to-world in OpenCV axes. TUM's files (freiburg benchmark) scale depth by 5000 per metre, Open3D's by
1000; a key "depth_scale" in the camera's JSON overrides both.
"""

from __future__ import annotations

import posixpath
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from services.edge.arrays import Floats
from services.edge.capture.depth import ImageColour, depth_file
from services.edge.capture.files import Folder, number, numbers, read_json, read_text, reading, unreadable
from services.edge.capture.images import image_size
from services.edge.capture.nouns import Capture, Intrinsics
from services.edge.capture.poses import pose_from_quaternion
from services.edge.capture.shots import Shot, matched, matrix_pinhole, missing_warning, no_poses, rgbd_capture
from services.edge.errors import CaptureError

OPEN3D_STEPS_PER_METRE = 1000.0
TUM_STEPS_PER_METRE = 5000.0
MAX_APART_S = 0.02  # seconds between a depth image and its pose or colour; the TUM tools' own default
PRIMESENSE = Intrinsics(525.0, 525.0, 319.5, 239.5, 640, 480)  # Open3D's and TUM's default camera
_COLOUR_FOLDERS = ("color", "rgb", "image", "colour", "images")
_IMAGES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".npy")
_UP_Z = np.array([0.0, 0.0, 1.0])  # TUM's motion capture world; Open3D's logs have no gravity


def matches(folder: Folder) -> bool:
    return folder.has_folder("depth") or folder.has("depth.txt")


def read(folder: Folder) -> Capture:
    truth = next((name for name in ("groundtruth.txt", "trajectory.txt", "traj.txt") if folder.has(name)), None)
    if truth is not None:
        return _read_tum(folder, truth)
    if folder.has("trajectory.log"):
        return _read_open3d(folder, "trajectory.log")
    return _unposed(_read_tum(folder, None) if folder.has("depth.txt") else _read_open3d(folder, None))


def _unposed(capture: Capture) -> Capture:
    """Without the poses that stood in for those that nobody knows, and that the checks wanted."""
    return replace(capture, frames=tuple(replace(frame, camera_to_world=None) for frame in capture.frames))


def _read_open3d(folder: Folder, log: str | None) -> Capture:
    """Images pair by their order, and with the poses of the log; without one all poses are the identity."""
    depths = folder.directly_in("depth", *_IMAGES)
    colours = _colour_files(folder)
    poses = [np.eye(4)] * len(depths) if log is None else read_log(folder, log)
    matched(len(depths), len(poses), file=log or "depth", what=f"poses in {log}")
    if colours:
        matched(len(depths), len(colours), file=posixpath.dirname(colours[0]), what="colour images")
    camera, scale = _camera(folder, depths, OPEN3D_STEPS_PER_METRE)
    pairs: list[str | None] = [*colours] if colours else [None] * len(depths)
    shots = [
        _shot(folder, depth, colour, pose, camera, scale)
        for depth, colour, pose in zip(depths, pairs, poses, strict=True)
    ]
    return rgbd_capture("open3d", shots, axes="opencv", up=None, file="depth")


def _colour_files(folder: Folder) -> list[str]:
    return next((found for name in _COLOUR_FOLDERS if (found := folder.directly_in(name, *_IMAGES))), [])


def _shot(
    folder: Folder, depth: str, colour: str | None, pose: Floats, camera: Intrinsics, steps_per_metre: float
) -> Shot:
    source = depth_file(folder.path(depth), depth, 1 / steps_per_metre)
    return Shot(depth, camera, pose, source, None, None if colour is None else ImageColour(folder.path(colour), colour))


def read_log(folder: Folder, log: str) -> list[Floats]:
    """(4,4) camera-to-world of every frame, from blocks of one line of metadata and four lines of matrix."""
    lines = [line for line in read_text(folder.path(log), log).splitlines() if line.strip()]
    if not lines:
        raise no_poses(log, "a pose in trajectory.log")
    if len(lines) % 5:
        raise CaptureError("CAPTURE_TRUNCATED", f"has {len(lines)} lines, not five per pose", file=log)
    blocks = (lines[at : at + 5] for at in range(0, len(lines), 5))
    return [numbers(" ".join(block[1:]).split(), 16, file=log, what="pose").reshape(4, 4) for block in blocks]


def _read_tum(folder: Folder, truth: str | None) -> Capture:
    """Associate depth, pose and colour by the nearest time stamp within MAX_APART_S; without a truth all poses are the
    identity."""
    depths, colours = _stamped(folder, "depth"), _stamped(folder, "rgb")
    if not depths:
        raise CaptureError("CAPTURE_EMPTY", "holds no depth images with time stamps", file="depth.txt")
    stamps, poses = _no_truth(depths) if truth is None else _ground_truth(folder, truth)
    camera, scale = _camera(folder, [name for _, name in depths if folder.has(name)], TUM_STEPS_PER_METRE)
    colour_stamps = np.array([seconds for seconds, _ in colours])
    shots, missing, unposed = [], [], []
    for stamp, depth in depths:
        pose = nearest(stamps, stamp)
        if not folder.has(depth):
            missing.append(depth)
        elif pose is None:
            unposed.append(depth)
        else:
            colour = nearest(colour_stamps, stamp)
            name = None if colour is None or not folder.has(colours[colour][1]) else colours[colour][1]
            shots.append(_shot(folder, depth, name, poses[pose], camera, scale))
    if not shots and missing:
        raise CaptureError(
            "CAPTURE_COUNT_MISMATCH", "is listed in depth.txt and missing, as is all depth", file=missing[0]
        )
    if not shots:
        raise no_poses(truth or "depth.txt", f"a pose within {MAX_APART_S} s of a depth image")
    warnings = (*missing_warning(missing, "depth images"), *missing_warning(unposed, "poses of depth images"))
    up = None if truth is None else _UP_Z
    return rgbd_capture("tum", shots, axes="opencv", up=up, file="depth", warnings=warnings)


def _no_truth(depths: Sequence[tuple[float, str]]) -> tuple[Floats, list[Floats]]:
    return np.array([seconds for seconds, _ in depths]), [np.eye(4)] * len(depths)


def _stamped(folder: Folder, what: str) -> list[tuple[float, str]]:
    """(seconds, name) sorted, from `depth.txt` or `rgb.txt`, else from file names that are time stamps."""
    index = f"{what}.txt"
    if folder.has(index):
        rows = [row.split() for row in _rows(read_text(folder.path(index), index))]
        if any(len(row) < 2 for row in rows):
            raise unreadable(index, "has a line without a time stamp and a file name")
        pairs = [(row[0], folder.inside(row[1], by=index)) for row in rows]
    else:
        pairs = [(posixpath.splitext(posixpath.basename(name))[0], name) for name in folder.directly_in(what, *_IMAGES)]
    return sorted((float(numbers(stamp, 1, file=index, what="time stamp")[0]), name) for stamp, name in pairs)


def _rows(text: str) -> list[str]:
    return [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]


def nearest(stamps: Floats, stamp: float) -> int | None:
    """The index of the time stamp closest to `stamp`, None when it is more than MAX_APART_S away."""
    if not len(stamps):
        return None
    apart = np.abs(stamps - stamp)
    index = int(np.argmin(apart))
    return index if apart[index] <= MAX_APART_S else None


def _ground_truth(folder: Folder, truth: str) -> tuple[Floats, list[Floats]]:
    """Seconds (N,) and poses, from lines of: time tx ty tz qx qy qz qw."""
    rows = _rows(read_text(folder.path(truth), truth))
    if not rows:
        raise no_poses(truth, "a pose in groundtruth.txt")
    with reading(truth, "trajectory"):
        table = np.loadtxt([row.replace(",", " ") for row in rows], ndmin=2)
    if table.shape[1] != 8:
        raise unreadable(truth, f"has {table.shape[1]} columns; time tx ty tz qx qy qz qw are eight")
    return table[:, 0], [pose_from_quaternion(row[1:4], row[4:8]) for row in table]


def _camera(folder: Folder, depths: Sequence[str], steps_per_metre: float) -> tuple[Intrinsics, float]:
    """From the first JSON with an intrinsic_matrix (column-major, as Open3D writes it), else the default camera."""
    for name in folder.directly_in("", ".json"):
        record = read_json(folder.path(name), name)
        if "intrinsic_matrix" in record:
            matrix = numbers(record["intrinsic_matrix"], 9, file=name, what="intrinsic_matrix").reshape(3, 3).T
            width, height = (_whole(number(record, key, file=name), name) for key in ("width", "height"))
            camera = matrix_pinhole(matrix, (width, height))
            scale = number(record, "depth_scale", file=name) if "depth_scale" in record else steps_per_metre
            if not 0 < scale < np.inf:
                raise unreadable(name, f"has the depth_scale {scale}")
            return camera, scale
    if not depths:
        raise CaptureError("CAPTURE_EMPTY", "holds no depth images", file="depth")
    return _default_camera(folder, depths[0]), steps_per_metre


def _whole(value: float, file: str) -> int:
    if not 1 <= value <= 1e6:
        raise unreadable(file, f"has an image side of {value} pixels")
    return int(value)


def _default_camera(folder: Folder, depth: str) -> Intrinsics:
    """The PrimeSense camera of Kinect and Structure sensors, whose images are 4:3."""
    width, height = image_size(folder.path(depth), depth) if not depth.endswith(".npy") else (640, 480)
    if width * 3 != height * 4:
        what = "there is no JSON with the camera's intrinsic_matrix"
        raise CaptureError("CAPTURE_BAD_INTRINSICS", what, file="depth", hints=("add a camera.json",))
    return PRIMESENSE.scaled_to(width, height)
