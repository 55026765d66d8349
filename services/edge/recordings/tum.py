"""Read folders of depth and colour images with a trajectory: Open3D's `trajectory.log`, TUM RGB-D's `groundtruth.txt`.

Without a trajectory the frames have no poses, and are in the order of their names or time stamps.

Poses are camera-to-world in OpenCV axes. TUM's files (freiburg benchmark) scale depth by 5000 per metre, Open3D's by
1000; a key "depth_scale" in the camera's JSON overrides both.
"""

from __future__ import annotations

import posixpath
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.calibration import find_calibration
from capture2vr.edge.capture.files import (
    Folder,
    data_lines,
    number,
    numbers,
    read_json,
    read_text,
    translate_errors,
    unreadable,
)
from capture2vr.edge.capture.frame_records import (
    check_counts_match,
    frame_of_files,
    matrix_pinhole,
    missing_warning,
    no_poses,
    rgbd_capture,
    without_poses,
)
from capture2vr.edge.capture.images import image_size
from capture2vr.edge.capture.nouns import Capture, Intrinsics
from capture2vr.edge.capture.poses import pose_from_quaternion
from capture2vr.edge.errors import CaptureError
from capture2vr.sentences.sentence import say

OPEN3D_STEPS_PER_METRE = 1000.0
TUM_STEPS_PER_METRE = 5000.0
MAX_APART_S = 0.02  # seconds between a depth image and its pose or colour image; the default of TUM's own tools
PRIMESENSE = Intrinsics(525.0, 525.0, 319.5, 239.5, 640, 480)  # Open3D's and TUM's default camera
_COLOUR_FOLDERS = ("color", "rgb", "image", "colour", "images")
_IMAGES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".npy")
_UP_Z = np.array([0.0, 0.0, 1.0])  # TUM's motion capture world; Open3D's logs have no gravity

_Stamped = tuple[float, str]
"""Seconds, and the name of an image."""


@dataclass(frozen=True, slots=True)
class _Associated:
    """Names of depth images: those with the index of their pose and the name of their colour image, if any; those that
    are not in the capture; those without a pose.
    """

    usable: list[tuple[str, int, str | None]]
    missing: list[str]
    unposed: list[str]


def matches(folder: Folder) -> bool:
    """Return whether there are depth images, as a folder `depth` or a list `depth.txt`."""
    return folder.has_folder("depth") or folder.has("depth.txt")


def read(folder: Folder) -> Capture:
    """Read the RGB-D frames, with poses if there is a trajectory. Raises CaptureError, naming the file."""
    truth = next((name for name in ("groundtruth.txt", "trajectory.txt", "traj.txt") if folder.has(name)), None)
    if truth is not None:
        return _read_tum(folder, truth)
    if folder.has("trajectory.log"):
        return _read_open3d(folder, "trajectory.log")
    return without_poses(_read_tum(folder, None) if folder.has("depth.txt") else _read_open3d(folder, None))


def _read_open3d(folder: Folder, log: str | None) -> Capture:
    """Read an Open3D folder: depth, colour and the log's poses pair by order; without a log all poses are identity."""
    depths = folder.directly_in("depth", *_IMAGES)
    colours = _colour_files(folder)
    poses = [np.eye(4)] * len(depths) if log is None else read_log(folder, log)
    check_counts_match(len(depths), len(poses), file=log or "depth", what=f"poses in {log}")
    if colours:
        check_counts_match(
            len(depths), len(colours), file=posixpath.dirname(colours[0]), what=say("word_colour_images")
        )
    camera, scale = folder_camera(folder, depths, OPEN3D_STEPS_PER_METRE)
    pairs: list[str | None] = [*colours] if colours else [None] * len(depths)
    records = [
        frame_of_files(folder, depth, camera, pose, 1 / scale, colour=colour)
        for depth, colour, pose in zip(depths, pairs, poses, strict=True)
    ]
    return rgbd_capture("open3d", records, axes="opencv", up=None, file="depth")


def _colour_files(folder: Folder) -> list[str]:
    """Return the colour images, from the first folder with a usual name that has any."""
    return next((found for name in _COLOUR_FOLDERS if (found := folder.directly_in(name, *_IMAGES))), [])


def read_log(folder: Folder, log: str) -> list[Floats]:
    """Read the (4,4) camera-to-world poses of a log: per frame one line of metadata and four lines of matrix."""
    lines = [line for line in read_text(folder.path(log), log).splitlines() if line.strip()]
    if not lines:
        raise no_poses(log, "a pose in trajectory.log")
    if len(lines) % 5:
        what = say("cut_off_has_lines_each", count=len(lines))
        raise CaptureError("CAPTURE_TRUNCATED", what, file=log)
    blocks = (lines[at : at + 5] for at in range(0, len(lines), 5))
    return [numbers(" ".join(block[1:]).split(), 16, file=log, what="pose").reshape(4, 4) for block in blocks]


def _read_tum(folder: Folder, truth: str | None) -> Capture:
    """Read a TUM folder: associate depth, pose and colour by the nearest time stamp within MAX_APART_S.

    Without a trajectory all poses are the identity.
    """
    depths, colours = _stamped_names(folder, "depth"), _stamped_names(folder, "rgb")
    if not depths:
        raise CaptureError("CAPTURE_EMPTY", say("has_no_stamped_depth_images"), file="depth.txt")
    stamps, poses = _placeholder_poses(depths) if truth is None else _ground_truth(folder, truth)
    camera, scale = folder_camera(folder, [name for _, name in depths if folder.has(name)], TUM_STEPS_PER_METRE)
    paired = _associate(folder, depths, colours, stamps)
    if not paired.usable:
        raise _nothing_usable(paired, truth)
    records = [
        frame_of_files(folder, depth, camera, poses[pose], 1 / scale, colour=colour)
        for depth, pose, colour in paired.usable
    ]
    warnings = (
        *missing_warning(paired.missing, say("word_depth_images")),
        *missing_warning(paired.unposed, say("word_poses_of_depth_images")),
    )
    up = None if truth is None else _UP_Z
    return rgbd_capture("tum", records, axes="opencv", up=up, file="depth", warnings=warnings)


def _associate(folder: Folder, depths: Sequence[_Stamped], colours: Sequence[_Stamped], stamps: Floats) -> _Associated:
    """Find the pose and the colour image of each depth image; `stamps` (N,) of the poses, in seconds."""
    paired = _Associated([], [], [])
    wanted = np.array([seconds for seconds, _ in depths])
    near_colours = nearest(np.array([seconds for seconds, _ in colours]), wanted)
    for (_, depth), pose, colour in zip(depths, nearest(stamps, wanted), near_colours, strict=True):
        if not folder.has(depth):
            paired.missing.append(depth)
        elif pose is None:
            paired.unposed.append(depth)
        else:
            name = None if colour is None else colours[colour][1]
            paired.usable.append((depth, pose, name if name is not None and folder.has(name) else None))
    return paired


def _nothing_usable(paired: _Associated, truth: str | None) -> CaptureError:
    if paired.missing:
        return CaptureError("CAPTURE_COUNT_MISMATCH", say("listed_in_depth_txt"), file=paired.missing[0])
    return no_poses(truth or "depth.txt", f"a pose within {MAX_APART_S} s of a depth image")


def _placeholder_poses(depths: Sequence[_Stamped]) -> tuple[Floats, list[Floats]]:
    """Return placeholder poses, the identity, at the time stamps of the depth images."""
    return np.array([seconds for seconds, _ in depths]), [np.eye(4)] * len(depths)


def _stamped_names(folder: Folder, what: str) -> list[_Stamped]:
    """Return images sorted by time, from `depth.txt` or `rgb.txt`, or else from time stamps in file names."""
    index = f"{what}.txt"
    if folder.has(index):
        rows = [row.split() for row in data_lines(read_text(folder.path(index), index))]
        if any(len(row) < 2 for row in rows):
            raise unreadable(index, say("has_line_not_time_stamp"))
        pairs = [(row[0], folder.resolve(row[1], by=index)) for row in rows]
    else:
        pairs = [(posixpath.splitext(posixpath.basename(name))[0], name) for name in folder.directly_in(what, *_IMAGES)]
    return sorted((float(numbers(stamp, 1, file=index, what="time stamp")[0]), name) for stamp, name in pairs)


def nearest(stamps: Floats, wanted: Floats) -> list[int | None]:
    """Return, for each time `wanted`, the index of the closest time stamp; None for more than MAX_APART_S away.

    Of equally close ones the first in time, and of equal ones the first in the list.
    """
    if not len(stamps):
        return [None] * len(wanted)
    known = np.where(np.isnan(stamps), np.inf, stamps)
    order = np.argsort(known, kind="stable")
    times = known[order]
    after = np.minimum(np.searchsorted(times, wanted), len(times) - 1)
    before = np.maximum(after - 1, 0)
    closest = np.where(np.abs(times[before] - wanted) <= np.abs(times[after] - wanted), before, after)
    first = np.searchsorted(times, times[closest])
    near = np.abs(times[first] - wanted) <= MAX_APART_S
    return [int(order[at]) if is_near else None for at, is_near in zip(first, near, strict=True)]


def _ground_truth(folder: Folder, truth: str) -> tuple[Floats, list[Floats]]:
    """Read time stamps (N,) in seconds and poses, from lines of: time tx ty tz qx qy qz qw."""
    rows = data_lines(read_text(folder.path(truth), truth))
    if not rows:
        raise no_poses(truth, "a pose in groundtruth.txt")
    with translate_errors(truth, "trajectory"):
        table = np.loadtxt([row.replace(",", " ") for row in rows], ndmin=2)
    if table.shape[1] != 8:
        raise unreadable(truth, say("has_columns_eight_needed_time", count=table.shape[1]))
    return table[:, 0], [pose_from_quaternion(row[1:4], row[4:8]) for row in table]


def folder_camera(folder: Folder, depths: Sequence[str], steps_per_metre: float) -> tuple[Intrinsics, float]:
    """Return intrinsics and depth steps per metre, from the first JSON with an intrinsic_matrix, or else from a text
    file with a calibration, or else the defaults.

    The JSON's matrix is column-major, as Open3D writes it.
    """
    for name in folder.directly_in("", ".json"):
        record = read_json(folder.path(name), name)
        if "intrinsic_matrix" in record:
            matrix = numbers(record["intrinsic_matrix"], 9, file=name, what="intrinsic_matrix").reshape(3, 3).T
            width, height = (_image_side(number(record, key, file=name), name) for key in ("width", "height"))
            camera = matrix_pinhole(matrix, (width, height))
            scale = number(record, "depth_scale", file=name) if "depth_scale" in record else steps_per_metre
            if not 0 < scale < np.inf:
                raise unreadable(name, say("has_depth_scale_not_positive", value=scale))
            return camera, scale
    if not depths:
        raise CaptureError("CAPTURE_EMPTY", say("has_no_depth_images"), file="depth")
    if not depths[0].endswith(".npy"):
        found = find_calibration(folder, image_size(folder.path(depths[0]), depths[0]))
        if found is not None:
            return found, steps_per_metre
    return _default_camera(folder, depths[0]), steps_per_metre


def _image_side(value: float, file: str) -> int:
    if not 1 <= value <= 1e6:
        raise unreadable(file, say("has_impossible_image_width_height", value=value))
    return int(value)


def _default_camera(folder: Folder, depth: str) -> Intrinsics:
    """Return the PrimeSense camera of Kinect and Structure sensors; CAPTURE_BAD_INTRINSICS for images unlike 4:3."""
    width, height = image_size(folder.path(depth), depth) if not depth.endswith(".npy") else (640, 480)
    if width * 3 != height * 4:
        what = say("has_images_x_no_json", width=width, height=height)
        hint = say("add_camera_json_with_width")
        raise CaptureError("CAPTURE_BAD_INTRINSICS", what, file="depth", hints=(hint,))
    return PRIMESENSE.scaled_to(width, height)
