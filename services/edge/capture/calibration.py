"""Find a recording's camera, and tell its tables from point clouds, by the content of the text files beside the frames.

A calibration is a camera matrix (fx 0 cx, 0 fy cy, 0 0 1; of 3 x 3, 3 x 4 or 4 x 4, on lines of its own or after a name
as KITTI's "P2:"), or values named fx, fy, cx and cy. What such files are called differs from recorder to recorder:
cam.info, calib.txt, intrinsics.cam, camera.yaml.
"""

from __future__ import annotations

import posixpath
import re

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture import photos
from capture2vr.edge.capture.files import Folder, data_lines, read_text, translate_errors
from capture2vr.edge.capture.frame_records import matrix_pinhole, pinhole
from capture2vr.edge.capture.nouns import Intrinsics

_SUFFIXES = (".txt", ".info", ".cam", ".calib", ".intr", ".intrinsics", ".pincam", ".yaml", ".yml", ".cfg", ".ini", "")
_MOST_BYTES = 65_536  # of a calibration; those of eight cameras with distortion take 2 kB
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
# Possessive, so that a run of blanks is read once, and not once from each of them.
_NAMED = re.compile(rf"\b(fx|fy|cx|cy|width|height)\b[\"']?(?:\s*+[:=]\s*+|[ \t]++)({_NUMBER})", re.IGNORECASE)
_EXACT = 1e-3  # elements of a camera matrix that have to be 0 or 1
_ORTHONORMAL = 1e-2  # error of a rotation's elements in a table of poses
_FEWEST_ROWS = 100  # of a cloud; a table of fewer beside pictures is none
_SAMPLE_ROWS = 200  # of a table that are looked at


def find_calibration(folder: Folder, size: tuple[int, int]) -> Intrinsics | None:
    """Return the first camera that a text file in or above the frames' folders has, for images of `size`, or None."""
    for name in sorted(folder.names, key=lambda name: name.count("/")):
        if posixpath.splitext(name)[1].lower() in _SUFFIXES and folder.path(name).stat().st_size <= _MOST_BYTES:
            text = read_text(folder.path(name), name)
            matrix = camera_matrix(text)
            if matrix is not None:
                return matrix_pinhole(matrix, size)
            if (named := _named_values(text, size)) is not None:
                return named
    return None


def camera_matrix(text: str) -> Floats | None:
    """Return the first camera matrix (3,3) that a text has, or None."""
    lines = [[float(word) for word in re.findall(_NUMBER, line.split(":", 1)[-1])] for line in data_lines(text)]
    for numbers in ([value for line in lines for value in line], *lines):
        if len(numbers) in (9, 12, 16):
            matrix = np.array(numbers).reshape(4 if len(numbers) == 16 else 3, -1)[:3, :3]
            if _is_camera(matrix):
                return matrix
    return None


def _is_camera(matrix: Floats) -> bool:
    zeros = np.abs([*matrix[1:, 0], matrix[0, 1], matrix[2, 1], matrix[2, 2] - 1])
    return bool(zeros.max() < _EXACT and matrix[0, 0] > 1 and matrix[1, 1] > 1 and (matrix[:2, 2] > 0).all())


def _named_values(text: str, size: tuple[int, int]) -> Intrinsics | None:
    """Return the camera of a text that names fx, fy, cx and cy, at its own width and height where it names them."""
    values = {name.lower(): float(value) for name, value in reversed(_NAMED.findall(text))}
    if not {"fx", "fy", "cx", "cy"} <= values.keys():
        return None
    width, height = (int(values.get(name, side)) for name, side in zip(("width", "height"), size, strict=True))
    focal_and_middle = np.array([values[name] for name in ("fx", "fy", "cx", "cy")])
    return pinhole(focal_and_middle, (max(width, 1), max(height, 1)))


def is_side_table(folder: Folder, name: str) -> bool:
    """Return whether a text table of numbers beside other files has no points.

    It is a matrix, a calibration, a table of poses or of measurements at times, or has few rows beside pictures.
    """
    with translate_errors(name, "table of numbers"), folder.path(name).open("rb") as stream:
        lines = [stream.readline(4096).decode("latin-1") for _ in range(_SAMPLE_ROWS)]
    rows = data_lines("".join(lines))
    if camera_matrix("".join(lines)) is not None or (len(rows) < _FEWEST_ROWS and photos.matches(folder)):
        return True
    numbers = [re.findall(_NUMBER, row) for row in rows]
    width = len(numbers[0]) if numbers else 0
    if any(len(row) != width for row in numbers):
        return False
    if len(rows) in (3, 4) and width in (3, 4):
        return True
    return _has_poses_or_times(np.array(numbers, np.float64).reshape(len(rows), width))


def _has_poses_or_times(table: Floats) -> bool:
    """Return whether a table (N,k) has a pose in each row, or a time."""
    rows, width = table.shape
    if width in (12, 16) and _are_matrices(table):
        return True
    has_quaternions = width in (7, 8) and _are_quaternions(table[:, -4:])
    return rows >= _FEWEST_ROWS and (has_quaternions or (width >= 7 and _are_times(table[:, 0])))


def _are_matrices(table: Floats) -> bool:
    """Return whether nine rows of ten (N,12 or 16) are poses, row by row."""
    turns = table.reshape(len(table), -1, 4)[:, :3, :3]
    off = np.abs(turns @ turns.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    return bool(np.mean(off < 2 * _ORTHONORMAL) > 0.9)


def _are_times(column: Floats) -> bool:
    """Return whether every number (N,) is larger than the one before: no scan sorts its points."""
    return bool((np.diff(column) > 0).all())


def _are_quaternions(table: Floats) -> bool:
    """Return whether nine rows of ten (N,4) have length 1."""
    return bool(np.mean(np.abs(np.linalg.norm(table, axis=1) - 1) < _ORTHONORMAL) > 0.9)
