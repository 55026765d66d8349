"""Read Android DEPTH16 recordings, by the app recorder-3d (Huawei AR): `N_depth16.bin`, `N_image.jpg`, `poses.csv`.

DEPTH16: little-endian words, 13 low bits millimetres (0 unknown), 3 high bits confidence, where 0 means "not given,
take it as 1" and 1 ... 7 run from 0 to 1 (android.graphics.ImageFormat.DEPTH16). Rows are the sensor's, landscape.

poses.csv: frame,tx,ty,tz,qx,qy,qz,qw,yaw,pitch,roll[,projection]; camera-to-world in OpenGL axes, Y against gravity.
`projection` is OpenGL's 4x4 projection of the screen, column by column. The screen crops one side of the sensor's 4:3
image, and which one depends on how the phone was held, so the smaller of the two focal entries belongs to the sensor's
width: f = width * min(P00, P11) / 2. For the Honor View 20 that is 178.8 px of 240. (The app's .ply files use 170.)
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.csv_rows import csv_rows
from capture2vr.edge.capture.depth import ImageColour
from capture2vr.edge.capture.files import Folder, numbers, read_text, translate_errors, truncated
from capture2vr.edge.capture.frame_records import FrameRecord, missing_warning, no_poses, rgbd_capture
from capture2vr.edge.capture.images import image_size, read_bytes
from capture2vr.edge.capture.nouns import Capture, Intrinsics
from capture2vr.edge.capture.poses import pose_from_quaternion
from capture2vr.sentences.sentence import say

POSES = "poses.csv"
DEFAULT_FOCAL = 170 / 240  # of the width: the app's own value, for recordings without a projection
_UP_Y = np.array([0.0, 1.0, 0.0])
_SUFFIX = "_depth16.bin"
_SHAPES = ((4, 3), (16, 9), (1, 1), (3, 2))  # aspect ratios of sensors, width : height, tried in this order

_Posed = tuple[str, Mapping[str, str]]
"""Name of a depth file, and its row of poses.csv."""


def matches(folder: Folder) -> bool:
    """Return whether the folder is a DEPTH16 recording."""
    return any(name.endswith(_SUFFIX) for name in folder.names)


def read(folder: Folder) -> Capture:
    """Read the frames of a recording. Raises CaptureError, naming the file."""
    depths = [name for name in folder.names if name.endswith(_SUFFIX)]
    if not folder.has(POSES):
        raise no_poses(depths[0], POSES)
    rows = _rows(folder)
    posed = [(name, rows[_frame_number(name)]) for name in depths if _frame_number(name) in rows]
    if not posed:
        raise no_poses(POSES, f"a row for {depths[0]}")
    unposed = [name for name in depths if _frame_number(name) not in rows]
    tracked, warnings = _tracked(posed)
    records = [_record(folder, name, row) for name, row in tracked]
    up = None if _is_untracked(tracked[0][1]) else _UP_Y
    warnings = [*missing_warning(unposed, say("word_poses_of_depth_images")), *warnings]
    return rgbd_capture("depth16", records, axes="opengl", up=up, file=POSES, warnings=warnings)


def _tracked(posed: list[_Posed]) -> tuple[list[_Posed], list[str]]:
    """Return the frames that were recorded while the phone was tracked, and a warning that there are others."""
    tracked = [(name, row) for name, row in posed if not _is_untracked(row)]
    if not tracked:
        return posed[:1], [say("tracking_never_began")]  # all poses are the same, so only one frame can be used
    lost = len(posed) - len(tracked)
    return tracked, [say("frames_recorded_before_tracking_began", lost=lost)] if lost else []


def _frame_number(name: str) -> str:
    """Return the frame's number from the name of its depth file."""
    return name.rsplit("/", 1)[-1].removesuffix(_SUFFIX)


def _rows(folder: Folder) -> dict[str, Mapping[str, str]]:
    """Read poses.csv: frame's number -> its row."""
    text = read_text(folder.path(POSES), POSES)
    with translate_errors(POSES, "CSV of poses"):
        rows: dict[str, Mapping[str, str]] = {row.get("frame", "").strip(): row for row in csv_rows(text)}
    if not rows:
        raise no_poses(POSES, "a row in poses.csv")
    return rows


def _vector(row: Mapping[str, str], *keys: str) -> Floats:
    return numbers([row.get(key) for key in keys], len(keys), file=POSES, what=", ".join(keys))


def _is_untracked(row: Mapping[str, str]) -> bool:
    """Return whether a row is from before tracking began: the AR engine reports exactly the origin until then."""
    return not _vector(row, "tx", "ty", "tz").any()


def _record(folder: Folder, name: str, row: Mapping[str, str]) -> FrameRecord:
    colour = _colour(folder, name)
    size = image_size(folder.path(colour), colour) if colour is not None else None
    depth = Depth16(folder.path(name), name, size)
    pose = pose_from_quaternion(_vector(row, "tx", "ty", "tz"), _vector(row, "qx", "qy", "qz", "qw"))
    width, height = depth.size()
    rgb = None if colour is None else ImageColour(folder.path(colour), colour)
    return FrameRecord(name, _camera(row, width, height), pose, depth, depth.load_confidence, rgb)


def _colour(folder: Folder, name: str) -> str | None:
    stem = name.removesuffix(_SUFFIX)
    names = (f"{stem}_image.jpg", f"{stem}_image_vga.jpg", f"{stem}_image.png")
    return next((name for name in names if folder.has(name)), None)


def _camera(row: Mapping[str, str], width: int, height: int) -> Intrinsics:
    """Compute intrinsics with square pixels from the row's projection.

    The projection's third column shifts the principal point, by a fraction of half of each side.
    """
    words = (row.get("projection") or "").split()
    if not words:
        focal = DEFAULT_FOCAL * width
        return Intrinsics(focal, focal, (width - 1) / 2, (height - 1) / 2, width, height)
    projection = numbers(words, 16, file=POSES, what="projection").reshape(4, 4).T
    across = (projection[0, 2], projection[1, 2])
    if projection[0, 0] > projection[1, 1]:  # phone held upright: the screen's -y is the sensor's x
        across = (-across[1], across[0])
    focal = width / 2 * float(min(projection[0, 0], projection[1, 1]))
    # On the cropped side the shift is a fraction of the part that the screen shows, not of the whole side.
    shown = width / 2 * float(min(projection[0, 0], projection[1, 1]) / max(projection[0, 0], projection[1, 1], 1e-9))
    cx = width / 2 * (1 - float(across[0])) - 0.5
    cy = height / 2 + shown * float(across[1]) - 0.5
    return Intrinsics(focal, focal, cx, cy, width, height)


@dataclass(frozen=True, slots=True)
class Depth16:
    """Depth image in a DEPTH16 file. The file has no width and height: they follow from the number of words and the
    aspect ratio of the colour image, or of common sensors."""

    path: Path
    file: str
    colour_size: tuple[int, int] | None

    def size(self) -> tuple[int, int]:
        words = self.path.stat().st_size // 2
        if words == 0:
            raise truncated(self.file, say("has_no_depth_values"))
        for across, down in (*((self.colour_size,) if self.colour_size else ()), *_SHAPES):
            width = round(math.sqrt(words * across / down))
            if words % width == 0 and abs(width * down - words // width * across) <= max(across, down):
                return width, words // width
        what = say("has_depth_values_fit", words=words)
        raise truncated(self.file, what)

    def load(self) -> Floats:
        return (self._words() & 0x1FFF).astype(np.float32) * np.float32(1e-3)

    def load_confidence(self) -> Floats:
        """Decode the confidence (H,W) float32: 0 means 1, else (value - 1) / 7, as Android defines it."""
        level = (self._words() >> 13).astype(np.float32)
        return np.where(level == 0, np.float32(1), (level - 1) / np.float32(7))

    def _words(self) -> np.ndarray[tuple[int, ...], np.dtype[np.uint16]]:
        width, height = self.size()
        data = read_bytes(self.path, self.file)
        return np.frombuffer(data, "<u2", width * height).reshape(height, width)
