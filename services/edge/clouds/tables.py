"""Read point clouds from tables of numbers: .xyz, .txt, .pts, .csv, and NumPy's .npy."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.files import translate_errors, unreadable
from capture2vr.edge.capture.nouns import Cloud
from capture2vr.edge.capture.npy_array import npy_array
from capture2vr.edge.clouds.colours import rgb8
from capture2vr.edge.clouds.raw_parts import LARGE, PART, RawPart, RawParts
from capture2vr.edge.clouds.unnamed_columns import column_layout
from capture2vr.edge.errors import CaptureError
from capture2vr.sentences.sentence import say

MAX_PARTED_POINTS = 200_000_000  # of files that are read in parts: 8 bytes each while a scene is sorted into tiles
MAX_POINTS = 20_000_000  # 20 million points of 24 bytes are 480 MB; a phone's scan has one to five million
_MAX_LINE = 10_000  # characters: NumPy takes 2.5 µs for each number, and a scan has tens of columns at most
_HEAD_BYTES = 2**16  # of a table, in which comments above the rows are looked for
_XYZ = ("x", "y", "z")
_RGB = (("red", "green", "blue"), ("r", "g", "b"), ("rf", "gf", "bf"))  # the last are CloudCompare's, of 0 to 1
_NORMAL = (("nx", "ny", "nz"), ("normal_x", "normal_y", "normal_z"))


def too_many_points(count: int, file: str, most: int = MAX_POINTS) -> CaptureError:
    """Return a CAPTURE_TOO_LARGE error for a file of `count` points."""
    hint = say("downsample_point_cloud_example")
    return CaptureError(
        "CAPTURE_TOO_LARGE",
        say("has_points_most_points_read", count=count, most=most),
        file=file,
        hints=(hint,),
    )


def read_npy(path: Path, file: str) -> Cloud:
    """Read a point cloud from a .npy: an array of shape (N, 3) or more columns, or of records with fields x, y, z."""
    array = npy_array(path, file)
    if array.dtype.fields is not None:
        return named_columns({name.lower(): array[name].reshape(-1) for name in array.dtype.names or ()}, file)
    if array.ndim != 2 or array.shape[1] < 3:
        raise unreadable(file, say("has_array_shape_points_need", shape=array.shape))
    if len(array) > MAX_POINTS:
        raise too_many_points(len(array), file)
    return _unnamed_columns(array.astype(np.float64))


def npy_parts(path: Path, file: str) -> RawParts | None:
    """Read a .npy in parts, by the names of its fields or its columns' values; None for other arrays."""
    array = npy_array(path, file)
    if len(array) <= LARGE or (array.dtype.fields is None and (array.ndim != 2 or array.shape[1] < 3)):
        return None
    if len(array) > MAX_PARTED_POINTS:
        raise too_many_points(len(array), file, MAX_PARTED_POINTS)
    at = None if array.dtype.fields is not None else column_layout(array).colours  # once: all parts have one layout

    def read() -> Iterator[RawPart]:
        for start in range(0, len(array), PART):
            rows = np.array(npy_array(path, file)[start : start + PART])  # a map of its own: its pages are freed
            if rows.dtype.fields is None:
                colours = None if at is None else rows[:, at : at + 3].astype(np.float32)
                yield RawPart(rows[:, :3].astype(np.float64), colours)
            else:
                yield raw_columns({name.lower(): rows[name].reshape(-1) for name in rows.dtype.names or ()}, file)

    return RawParts(len(array), read)


def raw_columns(columns: dict[str, NDArray[Any]], file: str) -> RawPart:
    """Return coordinates and raw colours of named columns of equal length."""
    _require_xyz(columns, file)
    return RawPart(np.stack([columns[name].astype(np.float64) for name in _XYZ], axis=1), _first_present(columns, _RGB))


def looks_numeric(head: str) -> bool:
    """Return whether a text starts with rows of at least three numbers, after comments and one header line."""
    lines = [line for line in head.splitlines()[:40] if line.strip() and not line.lstrip().startswith(("#", "//"))]
    rows = [_is_row(line) for line in lines[1:20]]
    return all(rows) if rows else bool(lines) and _is_row(lines[0])


def _is_row(line: str) -> bool:
    fields = _split(line)
    return len(fields) >= 3 and all(is_number(field) for field in fields[:3])


def _split(line: str) -> list[str]:
    if ";" in line:
        line = line.replace(",", ".")
    return re.split(r"[\s,;]+", line.strip(" \t\r\n,;"))


def is_number(text: str) -> bool:
    """Return whether a text is a number, as Python reads it."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def read_table(path: Path, file: str) -> Cloud:
    """Read a point cloud from rows of numbers. A header line names the columns, also where it is a comment.

    Without one the first three columns are x, y and z; what the others are is told by `column_layout`.
    """
    lines = _rows(path.read_bytes())
    if len(lines) > MAX_POINTS:
        raise too_many_points(len(lines), file)
    if (longest := max(map(len, lines), default=0)) > _MAX_LINE:
        raise unreadable(file, say("has_line_characters_rows_numbers", length=longest, most=_MAX_LINE))
    counted = _drop_point_count(lines)
    names = _column_names(lines, file)
    with translate_errors(file, "table of numbers"):
        table = np.loadtxt(lines, np.float64, comments=None, ndmin=2)
    if table.shape[1] < 3:
        raise unreadable(file, say("has_columns_points_need_least", count=table.shape[1]))
    names = names or _commented_names(path, table.shape[1])
    if names is None:
        return _unnamed_columns(table, counted=counted)
    return named_columns({name: table[:, column] for column, name in enumerate(names[: table.shape[1]])}, file)


def _rows(data: bytes) -> list[str]:
    """Return the data lines with blanks as separators. Decimal commas work when semicolons separate the fields."""
    text = data.decode("latin-1").removeprefix("\xef\xbb\xbf")
    first = next((line for line in text.splitlines() if line.strip()), "")
    if ";" in first:
        text = text.replace(",", ".").replace(";", " ")
    text = text.replace(",", " ").replace("//", "#")
    return [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]


def _drop_point_count(lines: list[str]) -> bool:
    """Remove the point count that a .pts begins with from `lines`; return whether there was one."""
    if len(lines) < 2 or not lines[0].strip().isdigit():
        return False
    del lines[0]
    return True


def _column_names(lines: list[str], file: str) -> list[str] | None:
    """Remove the header line from `lines`; return the column names that it has, or None without one."""
    first = lines[0].split() if lines else []
    if not first:
        raise CaptureError("CAPTURE_EMPTY", say("has_no_rows_numbers"), file=file, hints=(say("export_capture_again"),))
    if all(is_number(field) for field in first):
        return None
    del lines[0]
    if not lines:
        raise CaptureError("CAPTURE_EMPTY", say("has_header_line"), file=file)
    return [name.strip('"').lower() for name in first]


def _commented_names(path: Path, columns: int) -> list[str] | None:
    """Return the column names of a comment above the rows, as CloudCompare and NumPy write them, or None.

    It has a name for every column, x, y and z among them: a sentence about x, y and z names no columns.
    """
    with path.open("rb") as stream:
        head = stream.read(_HEAD_BYTES).decode("latin-1").removeprefix("\xef\xbb\xbf")
    for line in filter(None, map(str.strip, head.splitlines())):
        if not line.startswith(("#", "//")):
            return None
        words = line.lstrip("#/").strip(" \t,;").lower()
        separator = next((each for each in ";,\t" if each in words), None)  # names may have blanks, "Scalar field"
        names = [name.strip(' "') for name in words.split(separator)]
        if len(names) == columns and {*_XYZ} <= {*names}:
            return names
    return None


def named_columns(columns: dict[str, NDArray[Any]], file: str) -> Cloud:
    """Make a cloud from named columns of equal length; PLY, PCD, .npy and tables share these names."""
    _require_xyz(columns, file)
    xyz = np.stack([columns[name].astype(np.float64) for name in _XYZ], axis=1)
    colours = _first_present(columns, _RGB)
    normals = _first_present(columns, _NORMAL)
    return Cloud(
        xyz,
        rgb8(colours) if colours is not None else None,
        unit_normals(normals) if normals is not None else None,
    )


def _require_xyz(columns: dict[str, NDArray[Any]], file: str) -> None:
    if not all(name in columns for name in _XYZ):
        raise unreadable(file, say("has_no_columns_x_y", names=", ".join(list(columns)[:12])))


def _first_present(columns: dict[str, NDArray[Any]], choices: tuple[tuple[str, ...], ...]) -> NDArray[Any] | None:
    """Return the columns (N,k) of the first choice whose names all exist, or None."""
    for names in choices:
        if all(name in columns for name in names):
            return np.stack([columns[name] for name in names], axis=1)
    return None


def _unnamed_columns(table: Floats, *, counted: bool = False) -> Cloud:
    """Make a cloud from columns without names: x y z, then colours and normals, told apart by their values."""
    layout = column_layout(table, counted=counted)
    rgb, normals = (None if at is None else table[:, at : at + 3] for at in layout)
    return Cloud(
        table[:, :3],
        rgb8(rgb) if rgb is not None else None,
        unit_normals(normals) if normals is not None else None,
    )


def unit_normals(vectors: NDArray[Any]) -> Floats:
    """Normalise vectors (N,3) to float32 of length 1; zero and non-finite vectors become 0."""
    floats = np.nan_to_num(vectors.astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
    length = np.linalg.norm(floats, axis=1, keepdims=True)
    unit: Floats = np.divide(floats, length, out=np.zeros_like(floats), where=length > 1e-12)
    return unit
