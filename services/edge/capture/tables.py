"""Read point clouds from tables of numbers: .xyz, .txt, .pts, .csv, and NumPy's .npy."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.edge.arrays import Floats
from services.edge.capture.colours import rgb8
from services.edge.capture.files import translate_errors, unreadable
from services.edge.capture.nouns import Cloud
from services.edge.capture.raw_parts import LARGE, PART, RawPart, RawParts
from services.edge.errors import CaptureError

MAX_PARTED_POINTS = 200_000_000  # of files that are read in parts: 8 bytes each while a scene is sorted into tiles
MAX_POINTS = 20_000_000  # 20 million points of 24 bytes are 480 MB; a phone's scan has one to five million
_MAX_LINE = 10_000  # characters: NumPy takes 2.5 µs for each number, and a scan has tens of columns at most
_XYZ = ("x", "y", "z")
_RGB = (("red", "green", "blue"), ("r", "g", "b"))
_NORMAL = (("nx", "ny", "nz"), ("normal_x", "normal_y", "normal_z"))


def too_many_points(count: int, file: str, most: int = MAX_POINTS) -> CaptureError:
    """Return a CAPTURE_TOO_LARGE error for a file of `count` points."""
    hint = "downsample the point cloud, for example to a spacing of 1 mm"
    return CaptureError(
        "CAPTURE_TOO_LARGE",
        f"has {count:,} points; at most {most:,} points are read",
        file=file,
        hints=(hint,),
    )


def truncated(file: str, reason: str) -> CaptureError:
    """Return a CAPTURE_TRUNCATED error: the file is shorter than its own header says."""
    return CaptureError("CAPTURE_TRUNCATED", reason, file=file, hints=("copy or export the file again",))


def npy_array(path: Path, file: str) -> NDArray[Any]:
    """Memory-map the numeric array of a .npy; pickled objects are refused.

    Raises CAPTURE_TRUNCATED when the file is shorter than its header says, CAPTURE_EMPTY for an array of size 0, and
    CAPTURE_UNREADABLE.
    """
    with translate_errors(file, "NumPy array"), path.open("rb") as stream:
        version = np.lib.format.read_magic(stream)
        header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran, dtype = header(stream)
        start = stream.tell()
    if dtype.hasobject or (dtype.fields is None and dtype.kind not in "fiu"):
        raise unreadable(
            file, f"has values of type {dtype}; only integers and floats are read, and nothing is unpickled"
        )
    count = 1
    for side in shape:
        count *= int(side)
    if count < 0 or count * dtype.itemsize > path.stat().st_size - start:
        raise truncated(file, f"is cut off: it is too short for the array of shape {shape} that its header announces")
    if count == 0:
        raise CaptureError("CAPTURE_EMPTY", "has no numbers", file=file, hints=("export the capture again",))
    with translate_errors(file, "NumPy array"):
        return np.asarray(np.memmap(path, dtype, "r", start, shape, "F" if fortran else "C"))


def read_npy(path: Path, file: str) -> Cloud:
    """Read a point cloud from a .npy: an array of shape (N, 3) or more columns, or of records with fields x, y, z."""
    array = npy_array(path, file)
    if array.dtype.fields is not None:
        return named_columns({name.lower(): array[name].reshape(-1) for name in array.dtype.names or ()}, file)
    if array.ndim != 2 or array.shape[1] < 3:
        raise unreadable(file, f"has an array of shape {array.shape}; points need the shape (N, 3) or more columns")
    if len(array) > MAX_POINTS:
        raise too_many_points(len(array), file)
    return _unnamed_columns(array.astype(np.float64))


def npy_parts(path: Path, file: str) -> RawParts | None:
    """The points of a .npy in parts, by the names of its fields or its first three columns; None for other arrays."""
    array = npy_array(path, file)
    if len(array) <= LARGE or (array.dtype.fields is None and (array.ndim != 2 or array.shape[1] < 3)):
        return None
    if len(array) > MAX_PARTED_POINTS:
        raise too_many_points(len(array), file, MAX_PARTED_POINTS)

    def read() -> Iterator[RawPart]:
        for start in range(0, len(array), PART):
            rows = np.array(npy_array(path, file)[start : start + PART])  # a map of its own: its pages are freed
            if rows.dtype.fields is None:
                cloud = _unnamed_columns(rows.astype(np.float64))
                yield RawPart(cloud.xyz, cloud.rgb)
            else:
                yield raw_columns({name.lower(): rows[name].reshape(-1) for name in rows.dtype.names or ()}, file)

    return RawParts(len(array), read)


def raw_columns(columns: dict[str, NDArray[Any]], file: str) -> RawPart:
    """Coordinates, and colours as stored, of named columns of equal length."""
    _require_xyz(columns, file)
    return RawPart(np.stack([columns[name].astype(np.float64) for name in _XYZ], axis=1), _first_present(columns, _RGB))


def looks_numeric(head: str) -> bool:
    """Return whether a text starts with rows of at least three numbers, after comments and one header line."""
    lines = [line for line in head.splitlines()[:40] if line.strip() and not line.lstrip().startswith(("#", "//"))]
    rows = [_is_row(line) for line in lines[1:20]]
    return all(rows) if rows else bool(lines) and _is_row(lines[0])


def _is_row(line: str) -> bool:
    fields = _split(line)
    return len(fields) >= 3 and all(_is_number(field) for field in fields[:3])


def _split(line: str) -> list[str]:
    if ";" in line:
        line = line.replace(",", ".")
    return re.split(r"[\s,;]+", line.strip(" \t\r\n,;"))


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def read_table(path: Path, file: str) -> Cloud:
    """Read a point cloud from rows of numbers. A header line names the columns; without one the first 3 are x, y, z."""
    lines = _rows(path.read_bytes())
    if len(lines) > MAX_POINTS:
        raise too_many_points(len(lines), file)
    if (longest := max(map(len, lines), default=0)) > _MAX_LINE:
        raise unreadable(file, f"has a line of {longest:,} characters; rows of numbers have at most {_MAX_LINE:,}")
    names = _column_names(lines, file)
    with translate_errors(file, "table of numbers"):
        table = np.loadtxt(lines, np.float64, comments=None, ndmin=2)
    if table.shape[1] < 3:
        raise unreadable(file, f"has {table.shape[1]} columns; points need at least three: x, y and z")
    if names is None:
        return _unnamed_columns(table)
    return named_columns({name: table[:, column] for column, name in enumerate(names[: table.shape[1]])}, file)


def _rows(data: bytes) -> list[str]:
    """Return the data lines with blanks as separators. Decimal commas work when semicolons separate the fields."""
    text = data.decode("latin-1").removeprefix("\xef\xbb\xbf")
    first = next((line for line in text.splitlines() if line.strip()), "")
    if ";" in first:
        text = text.replace(",", ".").replace(";", " ")
    text = text.replace(",", " ").replace("//", "#")
    return [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]


def _column_names(lines: list[str], file: str) -> list[str] | None:
    """Remove the header line (column names, or the point count of a .pts) from `lines`; return the names, if any."""
    first = lines[0].split() if lines else []
    if not first:
        raise CaptureError("CAPTURE_EMPTY", "has no rows of numbers", file=file, hints=("export the capture again",))
    if len(first) == 1 and first[0].isdigit() and len(lines) > 1:
        del lines[0]
        return None
    if all(_is_number(field) for field in first):
        return None
    del lines[0]
    if not lines:
        raise CaptureError("CAPTURE_EMPTY", "has a header line, but no rows of numbers", file=file)
    return [name.strip('"').lower() for name in first]


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
        raise unreadable(file, f"has no columns x, y and z; its columns are {', '.join(list(columns)[:12])}")


def _first_present(columns: dict[str, NDArray[Any]], choices: tuple[tuple[str, ...], ...]) -> NDArray[Any] | None:
    """Return the columns (N,k) of the first choice whose names all exist, or None."""
    for names in choices:
        if all(name in columns for name in names):
            return np.stack([columns[name] for name in names], axis=1)
    return None


def _unnamed_columns(table: Floats) -> Cloud:
    """Make a cloud from columns without names: x y z, then colours and normals, told apart by their values.

    Three columns of unit vectors are normals, three of 0..255 or 0..1 are colours.
    """
    rgb = normals = None
    extra = table[:, 3:] if table.shape[1] in (6, 9) else table[:, 4:] if table.shape[1] in (7, 10) else table[:, :0]
    for start in range(0, extra.shape[1] - 2, 3):
        triple = extra[:, start : start + 3]
        if normals is None and _unit_length(triple):
            normals = unit_normals(triple)
        elif rgb is None and np.nanmin(triple, initial=0.0) >= 0:
            rgb = rgb8(triple)
    return Cloud(table[:, :3], rgb, normals)


def _unit_length(vectors: Floats) -> bool:
    """Return whether over 90 % of the rows have length 1 within 1 %, which colours do not have."""
    sample = vectors[:: max(1, len(vectors) // 10_000)]
    return bool(np.mean(np.abs(np.linalg.norm(sample, axis=1) - 1.0) < 0.01) > 0.9)


def unit_normals(vectors: NDArray[Any]) -> Floats:
    """Normalise vectors (N,3) to float32 of length 1; zero and non-finite vectors become 0."""
    floats = np.nan_to_num(vectors.astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
    length = np.linalg.norm(floats, axis=1, keepdims=True)
    unit: Floats = np.divide(floats, length, out=np.zeros_like(floats), where=length > 1e-12)
    return unit
