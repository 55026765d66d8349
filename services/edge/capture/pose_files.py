"""Read folders with a pose file beside every depth image, the layouts of research data sets.

7-Scenes, 3DMatch and BundleFusion have `frame-N.depth.png`, `frame-N.color.png` and `frame-N.pose.txt`; ScanNet's
export has `depth/N.png`, `color/N.jpg` and `pose/N.txt`. Depth is u16 mm, or as `m_depthShift` says. A pose is a 4 x 4
camera-to-world matrix in OpenCV axes and metres, of infinities or NaN where tracking was lost. The camera stands in
`camera-intrinsics.txt` (3DMatch), `intrinsic/intrinsic_depth.txt` (ScanNet), `info.txt` (BundleFusion) or another
text file with a calibration; 7-Scenes has no file of it.
"""

from __future__ import annotations

import posixpath
import re
from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.calibration import find_calibration
from capture2vr.edge.capture.files import Folder, numbers, read_text, unreadable
from capture2vr.edge.capture.frame_records import (
    FrameRecord,
    check_mostly_paired,
    frame_of_files,
    matrix_pinhole,
    no_poses,
    rgbd_capture,
    without_poses,
)
from capture2vr.edge.capture.images import image_size
from capture2vr.edge.capture.nouns import Capture, Intrinsics
from capture2vr.edge.errors import CaptureError
from capture2vr.sentences.sentence import say

STEPS_PER_METRE = 1000.0
KINECT = Intrinsics(585.0, 585.0, 320.0, 240.0, 640, 480)  # the depth camera of 7-Scenes, as its authors give it
_FRAME = re.compile(r"(.*frame-\d+)\.depth\.png", re.IGNORECASE)
_NUMBERED = re.compile(r"((?:.*/)?)depth/(\d+)\.png", re.IGNORECASE)
_MATRIX_FILES = ("camera-intrinsics.txt", "camera_intrinsics.txt", "intrinsic_depth.txt")
_INFO_FILES = ("info.txt", "_info.txt")
_DEFAULT_CAMERA = say("no_file_has_camera_intrinsics")


@dataclass(frozen=True, slots=True)
class _FrameFiles:
    """The names of a frame's files, as they should be; only the depth image is known to exist."""

    depth: str
    colours: tuple[str, ...]
    pose: str


def matches(folder: Folder) -> bool:
    """Return whether depth images are named `frame-N.depth.png`, or have files of their names in a folder `pose`."""
    return bool(_listed(folder))


def read(folder: Folder) -> Capture:
    """Read the RGB-D frames, with poses if any frame has one. Raises CaptureError, naming the file."""
    listed = _listed(folder)
    kind = "7scenes" if _FRAME.fullmatch(listed[0].depth) else "scannet"
    camera, steps_per_metre, warnings = _camera(folder, listed[0].depth)
    posed = [each for each in listed if folder.has(each.pose)]
    if not posed:
        still = [_record(folder, each, np.eye(4), camera, steps_per_metre) for each in listed]
        return without_poses(rgbd_capture(kind, still, axes="opencv", up=None, file="depth", warnings=warnings))
    warnings += check_mostly_paired(len(posed), len(listed), len(posed), file=posed[0].pose, what=say("word_poses"))
    poses = [_read_pose(folder, each.pose) for each in posed]
    tracked = [(each, pose) for each, pose in zip(posed, poses, strict=True) if np.isfinite(pose).all()]
    if not tracked:
        raise no_poses(posed[0].pose, "a pose of finite numbers")
    if len(tracked) < len(posed):
        warnings += (say("tracking_lost_in_frames", lost=len(posed) - len(tracked), count=len(posed)),)
    records = [_record(folder, each, pose, camera, steps_per_metre) for each, pose in tracked]
    return rgbd_capture(kind, records, axes="opencv", up=None, file="depth", warnings=warnings)


def _listed(folder: Folder) -> list[_FrameFiles]:
    """Return the frames of the layout whose depth images the folder has, in natural order."""
    found = [(name, match) for name in folder.names if (match := _FRAME.fullmatch(name))]
    if found:
        return [
            _FrameFiles(name, tuple(f"{match[1]}.color.{kind}" for kind in ("png", "jpg")), f"{match[1]}.pose.txt")
            for name, match in found
        ]
    found = [(name, match) for name in folder.names if (match := _NUMBERED.fullmatch(name))]
    numbered = [
        _FrameFiles(
            name,
            tuple(f"{match[1]}color/{match[2]}.{kind}" for kind in ("jpg", "png")),
            f"{match[1]}pose/{match[2]}.txt",
        )
        for name, match in found
    ]
    return numbered if any(folder.has(each.pose) for each in numbered) else []


def _record(
    folder: Folder, files: _FrameFiles, pose: Floats, camera: Intrinsics, steps_per_metre: float
) -> FrameRecord:
    colour = next((name for name in files.colours if folder.has(name)), None)
    return frame_of_files(folder, files.depth, camera, pose, 1 / steps_per_metre, colour=colour)


def _read_pose(folder: Folder, name: str) -> Floats:
    """Read a pose (4,4), of whatever numbers."""
    return numbers(read_text(folder.path(name), name).split(), 16, file=name, what="pose").reshape(4, 4)


def _camera(folder: Folder, depth: str) -> tuple[Intrinsics, float, tuple[str, ...]]:
    """Return intrinsics, depth steps per metre and warnings, from the first file that has the camera."""
    size = image_size(folder.path(depth), depth)
    for name in folder.names:
        file = posixpath.basename(name).lower()
        if file in _MATRIX_FILES:
            return matrix_pinhole(_matrix(read_text(folder.path(name), name).split(), name), size), STEPS_PER_METRE, ()
        if file in _INFO_FILES:
            info = dict(re.findall(r"^(\w+)\s*=\s*(.*)$", read_text(folder.path(name), name), re.MULTILINE))
            if "m_calibrationDepthIntrinsic" in info:
                matrix = _matrix(info["m_calibrationDepthIntrinsic"].split(), name)
                steps = float(numbers(info.get("m_depthShift", STEPS_PER_METRE), 1, file=name, what="m_depthShift")[0])
                if not 0 < steps < np.inf:
                    raise unreadable(name, say("has_m_depthshift_not_positive", value=steps))
                return matrix_pinhole(matrix, size), steps, ()
    if (found := find_calibration(folder, size)) is not None:
        return found, STEPS_PER_METRE, ()
    if size[0] * 3 != size[1] * 4:
        what = say("x_no_file_has_camera", width=size[0], height=size[1])
        hint = say("add_camera_intrinsics_txt")
        raise CaptureError("CAPTURE_BAD_INTRINSICS", what, file=depth, hints=(hint,))
    return KINECT.scaled_to(*size), STEPS_PER_METRE, (_DEFAULT_CAMERA,)


def _matrix(words: list[str], file: str) -> Floats:
    """Convert a camera matrix of 9 or 16 numbers, row by row, to (3,3)."""
    side = 4 if len(words) == 16 else 3
    return numbers(words, side * side, file=file, what="camera matrix").reshape(side, side)[:3, :3]
