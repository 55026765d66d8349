"""Read Leica's .ptx: the scans of a survey as text, each in the frame of its scanner, with the scanner's pose.

A scan is the number of its columns and of its rows, the scanner's place and axes in four lines, a matrix in four lines
by which its points are multiplied from the left, as rows x y z 1, and a line "x y z intensity", perhaps with "r g b"
behind, for each of its beams; 0 0 0 is a beam without a return.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import TextIO

import numpy as np

from capture2vr.edge.arrays import Floats, Tick
from capture2vr.edge.capture.files import numbers, translate_errors, truncated, unreadable
from capture2vr.edge.capture.nouns import Capture, Cloud
from capture2vr.edge.clouds.cloud import capture_of_cloud
from capture2vr.edge.clouds.cloud_process import greyed_warning
from capture2vr.edge.clouds.colours import read_colours
from capture2vr.edge.clouds.tables import MAX_POINTS, too_many_points
from capture2vr.edge.errors import CaptureError
from capture2vr.sentences.sentence import say

_MAX_BYTES = 2**31  # of a file: 20 million beams take 1 GB
_LEAST_LINE = 8  # bytes: "0 0 0 0" and its end
_LONGEST_LINE = 1_000  # characters
_PIECE = 500_000  # beams that are parsed at once
_GREY = 128  # sRGB, of a scan without colours beside scans that have them
_ENDS = np.array([0.0, 0.0, 0.0, 1.0])  # of a matrix: its last column, or its last row where it is written transposed
_HEAD_BYTES = 4096
# Possessive, so that a run of blanks is read once, and not once from each of them.
_N = rb"[-+]?[\d.]++(?:[eE][-+]?\d++)?"
_HEAD = re.compile(
    rb"\s*+\d++[ \t]*+\r?\n[ \t]*+\d++[ \t]*+\r?\n"
    + rb"".join(rb"(?:[ \t]*+%b(?:[ \t]++%b){%d}[ \t]*+\r?\n){4}" % (_N, _N, others) for others in (2, 3))
)


def is_ptx(head: bytes) -> bool:
    """Return whether a file begins as a scan does: two counts, four lines of three numbers, and four of four."""
    return _HEAD.match(head[:_HEAD_BYTES]) is not None


def read_ptx(path: Path, file: str, tick: Tick) -> Capture:
    """Read all scans of a .ptx, each by its matrix. Scans without colours are grey, where others have some."""
    size = path.stat().st_size
    if size > _MAX_BYTES:
        what = say("larger_than_mib_most_read", size=_MAX_BYTES // 2**20, kind="PTX")
        raise CaptureError("CAPTURE_TOO_LARGE", what, file=file, hints=(say("export_scan_as_las_laz"),))
    with translate_errors(file, ".ptx"), path.open(encoding="latin-1") as stream:
        scans = list(_scans(stream, size, file, tick))
    xyz = np.concatenate([points for points, _ in scans])
    coloured = any(values.shape[1] == 3 for _, values in scans)
    if not coloured:
        rgb, notes = read_colours(None, np.concatenate([values for _, values in scans])[:, 0])
        return capture_of_cloud(Cloud(xyz, rgb, notes=notes), file, "ptx")
    whole = [values if values.shape[1] == 3 else np.full((len(values), 3), _GREY) for _, values in scans]
    rgb, notes = read_colours(np.concatenate(whole))
    grey = sum(len(values) for _, values in scans if values.shape[1] != 3)
    warnings = (greyed_warning(grey, len(xyz), file),) if grey else ()
    return capture_of_cloud(Cloud(xyz, rgb, notes=notes), file, "ptx", warnings)


def _scans(stream: TextIO, size: int, file: str, tick: Tick) -> Iterator[tuple[Floats, Floats]]:
    """Yield each scan's points (N,3), NaN where nothing came back, and their colours (N,3) or intensities (N,1)."""
    left, read = size, 0
    while head := list(islice((line for line in iter(lambda: stream.readline(_LONGEST_LINE), "") if line.strip()), 10)):
        matrix, beams = _header(head, file)
        if beams > left // _LEAST_LINE + 1:
            what = say("beams_least_bytes", count=beams, need=beams * _LEAST_LINE, left=left)
            raise truncated(file, say("cut_off_header_announces", what=what))
        read += beams
        if read > MAX_POINTS:
            raise too_many_points(read, file)
        table, used = _beams(stream, beams, file, tick)
        left -= used
        points = table[:, :3] @ matrix[:3, :3] + matrix[3, :3]
        points[~table[:, :3].any(axis=1)] = np.nan
        yield points, table[:, 4:7] if table.shape[1] >= 7 else table[:, 3:4]


def _header(lines: list[str], file: str) -> tuple[Floats, int]:
    """Return the matrix (4,4) of a scan, and its number of beams."""
    if len(lines) < 10:
        raise truncated(file, say("cut_off_inside_header"))
    columns, rows = (numbers(line.split(), 1, file=file, what="columns, rows")[0] for line in lines[:2])
    if not (columns >= 0 and rows >= 0 and columns * rows <= MAX_POINTS):
        raise too_many_points(int(np.nan_to_num(columns * rows).clip(0, 1e15)), file)
    matrix = numbers(" ".join(lines[6:]).split(), 16, file=file, what="matrix").reshape(4, 4)
    if not (matrix[:, 3] == _ENDS).all() and (matrix[3] == _ENDS).all():
        matrix = matrix.T
    if not np.isfinite(matrix).all() or np.abs(matrix[:, 3] - _ENDS).max() > 1e-6:
        raise unreadable(file, say("has_scan_without_pose"))
    return matrix, int(columns) * int(rows)


def _beams(stream: TextIO, count: int, file: str, tick: Tick) -> tuple[Floats, int]:
    """Read the lines of `count` beams: the numbers (N,4) or (N,7), and how many bytes they took."""
    tables: list[Floats] = []
    used = 0
    for start in range(0, count, _PIECE):
        tick(0.0)
        wanted = min(_PIECE, count - start)
        lines = list(islice(iter(lambda: stream.readline(_LONGEST_LINE), ""), wanted))
        if len(lines) < wanted:
            what = say("beams_but", count=count, found=start + len(lines))
            raise truncated(file, say("cut_off_header_announces", what=what))
        used += sum(map(len, lines))
        tables.append(np.loadtxt(lines, np.float64, comments=None, ndmin=2))
    table = np.concatenate(tables) if tables else np.zeros((0, 4))
    if len(table) != count or table.shape[1] not in (4, 7):
        raise unreadable(file, say("has_beams_of_columns", count=table.shape[1]))
    return table, used
