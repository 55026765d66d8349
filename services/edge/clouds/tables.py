"""Read point clouds from tables of numbers: .xyz, .txt, .pts, .csv, and NumPy's .npy."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.files import translate_errors, unreadable
from capture2vr.edge.capture.nouns import Cloud
from capture2vr.edge.capture.npy_array import npy_array
from capture2vr.edge.capture.text_encoding import encoding_of
from capture2vr.edge.clouds.colours import read_colours
from capture2vr.edge.clouds.column_names import meanings
from capture2vr.edge.clouds.raw_parts import LARGE, PART, RawPart, RawParts
from capture2vr.edge.clouds.table_columns import named_by, without_names
from capture2vr.edge.clouds.table_dialect import Dialect, dialect_of, is_content, width_of
from capture2vr.edge.clouds.table_rows import RowReader, shown_rows
from capture2vr.edge.clouds.table_text import pieces
from capture2vr.edge.clouds.unnamed_columns import MOST_COLUMNS, ColumnLayout, column_layout
from capture2vr.edge.errors import CaptureError
from capture2vr.order.reading import TableColumns
from capture2vr.sentences.sentence import say, with_values

MAX_PARTED_POINTS = 200_000_000  # of files that are read in parts: 8 bytes each while a scene is sorted into tiles
MAX_POINTS = 20_000_000  # 20 million points of 24 bytes are 480 MB; a phone's scan has one to five million
_MAX_LINE = 10_000  # characters: NumPy takes 2.5 µs for each number, and a scan has tens of columns at most
_HEAD_BYTES = 2**16  # of a table, by which its encoding is told
_LOOKED_AT = 400  # lines by which it is told how rows are written, and what their columns are
_ENOUGH_ROWS, _ENOUGH_NAMED = 0.9, 0.6
"""Shares of a text's lines, from the first row on, that are rows in a table; the other one where its columns have the
names of coordinates."""
_XYZ = ("x", "y", "z")
RGB = (("red", "green", "blue"), ("rf", "gf", "bf"))  # the last are CloudCompare's, of 0 to 1
_NORMAL = (("nx", "ny", "nz"),)


def too_many_points(count: int, file: str, most: int = MAX_POINTS) -> CaptureError:
    """Return a CAPTURE_TOO_LARGE error for a file of `count` points."""
    what = say("has_points_most_points_read", count=count, most=most)
    return CaptureError("CAPTURE_TOO_LARGE", what, file=file, hints=(say("downsample_point_cloud_example"),))


def read_npy(path: Path, file: str) -> Cloud:
    """Read a point cloud from a .npy: an array of shape (N, 3) or more columns, or of records with fields x, y, z."""
    array = npy_array(path, file)
    if array.dtype.fields is not None:
        return named_columns({name.lower(): array[name].reshape(-1) for name in array.dtype.names or ()}, file)
    if array.ndim != 2 or array.shape[1] < 3:
        raise unreadable(file, say("has_array_shape_points_need", shape=array.shape))
    if len(array) > MAX_POINTS:
        raise too_many_points(len(array), file)
    table = array.astype(np.float64)
    return _unnamed_columns(table, column_layout(table))


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
    columns = _by_meaning(columns, file)
    return RawPart(np.stack([columns[name].astype(np.float64) for name in _XYZ], axis=1), first_present(columns, RGB))


def looks_numeric(text: str) -> bool:
    """Return whether a text is a table of points: most of its first lines are rows of at least three numbers, all but
    remarks and a header."""
    lines = text.split("\n")[: 2 * _LOOKED_AT]
    if max(map(len, lines)) > _MAX_LINE or (dialect := dialect_of(list(filter(is_content, lines)))) is None:
        return False
    first = _first_row(lines, dialect)
    rows = list(filter(is_content, lines[first:]))
    named, _ = named_by(lines[:first], dialect, width_of(dialect, rows))
    return sum(map(dialect.is_row, rows)) >= (_ENOUGH_NAMED if named else _ENOUGH_ROWS) * len(rows)


def read_table(path: Path, file: str, told: TableColumns | None = None) -> tuple[Cloud, tuple[str, ...], TableColumns]:
    """Read a point cloud from rows of numbers: the cloud, warnings, and its columns, with the unit of the coordinates.

    The encoding, the separator and the decimal mark are told by the rows. A header line names the columns, also where
    it is a remark. Without one the first three columns of numbers are x, y and z, but for leading ones that count; what
    the others are is told by `column_layout`.

    told: the columns, where a person told them
    """
    with translate_errors(file, "table of numbers"):
        layout = _layout_of(path, file, told)
        reader = RowReader(layout.dialect, layout.used)
        table = _read_rows(reader, path, layout, file)
    if layout.columns:
        cloud, columns = _of_columns(table, layout.columns), layout.columns
    else:
        places = column_layout(table, counted=layout.counted)
        cloud, columns = _unnamed_columns(table, places), places.among(layout.used)
    cloud = replace(cloud, of_table=shown_rows(layout.rows, layout.dialect, columns))
    notes = () if told else _notes(layout, cloud, file)
    columns = replace(columns, metres=1.0) if columns.degrees else columns  # heights are in metres now
    return cloud, (*notes, *_left_out(reader, len(table), file)), columns


@dataclass(frozen=True, slots=True)
class _Layout:
    """How a table is written.

    encoding, mark  of its text, and how many bytes mark it
    dialect         of its rows, the first of which is line `first`
    columns         that its header names; None without one
    used            the numbers of the columns that are read
    counted         whether the number of points stands above the rows, as in a .pts
    rows            the first ones, as they are written
    """

    encoding: str
    mark: int
    dialect: Dialect
    first: int
    columns: TableColumns | None
    used: tuple[int, ...]
    counted: bool
    rows: Sequence[str]


def _layout_of(path: Path, file: str, told: TableColumns | None) -> _Layout:
    """Tell how a table is written by its first lines. Raises CaptureError where that is no table of points."""
    encoding, mark = encoding_of(_head(path))
    lines = _first_lines(path, encoding, mark, file)
    dialect = dialect_of(list(filter(is_content, lines)))
    if dialect is None:
        raise _no_rows(lines, file)
    first = _first_row(lines, dialect)
    header, below = lines[:first], [line for line in lines[first:] if dialect.is_row(line)]
    width = width_of(dialect, below)
    columns, names = named_by(header, dialect, width)
    if told is not None:
        columns = _there(told, columns, width, file)
    if columns is None and names:
        raise _no_columns(names, file)
    used = columns.used if columns else without_names([dialect.fields(line) for line in below], dialect)[:MOST_COLUMNS]
    if len(used) < 3:
        raise unreadable(file, say("has_columns_points_need_least", count=len(used)))
    counted = any(line.strip().isdigit() for line in header)
    return _Layout(encoding, mark, dialect, first, columns, used, counted, below)


def _there(told: TableColumns, named: TableColumns | None, width: int, file: str) -> TableColumns:
    """Return the columns that a person told, in the unit of those that the header names. Raises CAPTURE_UNREADABLE
    where a table is not as wide."""
    if (last := 1 + max(told.used)) > width:
        raise unreadable(file, say("has_only_columns", count=width, named=last), say("number_columns_from_one"))
    if named is None or (named.degrees and {*told.xyz[:2]} != {*named.xyz[:2]}):
        return told
    return replace(told, metres=named.metres, degrees=named.degrees)


def _no_columns(names: Sequence[str], file: str) -> CaptureError:
    """Return the error for names of columns none of which are x, y and z."""
    return unreadable(file, say("has_no_columns_x_y", names=", ".join(names[:12])))


def _head(path: Path) -> bytes:
    with path.open("rb") as stream:
        return stream.read(_HEAD_BYTES)


def _first_lines(path: Path, encoding: str, mark: int, file: str) -> list[str]:
    """Return the first lines of a table, the last of which may be cut off where there are more."""
    text = next(pieces(path, encoding, mark), "")
    lines = text[: _MAX_LINE * _LOOKED_AT].split("\n")[: 2 * _LOOKED_AT]
    if not any(line.strip() for line in lines):
        raise CaptureError("CAPTURE_EMPTY", say("has_no_rows_numbers"), file=file, hints=(say("export_capture_again"),))
    if (longest := max(map(len, lines), default=0)) > _MAX_LINE:
        raise unreadable(file, say("has_line_characters_rows_numbers", length=longest, most=_MAX_LINE))
    return lines


def _first_row(lines: Sequence[str], dialect: Dialect) -> int:
    """Return the number of the first line that is a row."""
    return next(number for number, line in enumerate(lines) if dialect.is_row(line))


def _no_rows(lines: Sequence[str], file: str) -> CaptureError:
    """Return the error for lines none of which is a row of three numbers."""
    rows = list(filter(is_content, lines))
    if not rows:
        return CaptureError("CAPTURE_EMPTY", say("has_no_rows_numbers"), file=file)
    if len(rows) == 1:
        return CaptureError("CAPTURE_EMPTY", say("has_header_line"), file=file)
    return unreadable(file, say("has_no_rows_of_three_numbers"))


def _read_rows(reader: RowReader, path: Path, layout: _Layout, file: str) -> Floats:
    """Read all rows of a table piece by piece. Raises CAPTURE_TOO_LARGE, and for a long line."""
    tables: list[Floats] = []
    count = 0
    for number, text in enumerate(pieces(path, layout.encoding, layout.mark)):
        text = text if number else text.split("\n", layout.first)[-1]
        if len(text) > _MAX_LINE and (longest := max(map(len, text.split("\n")))) > _MAX_LINE:
            raise unreadable(file, say("has_line_characters_rows_numbers", length=longest, most=_MAX_LINE))
        tables.append(reader.read(text))
        count += len(tables[-1])
        if count > MAX_POINTS:
            raise too_many_points(count, file)
    return np.concatenate(tables)


def _of_columns(table: Floats, columns: TableColumns) -> Cloud:
    """Make a cloud of a table that has the columns in the order of `TableColumns.used`."""
    at = 3 + len(columns.rgb)
    intensity = None if columns.intensity is None else table[:, -1]
    rgb, notes = read_colours(table[:, 3:at] if columns.rgb else None, intensity)
    xyz = table[:, :3] * (1, 1, columns.metres or 1) if columns.degrees else table[:, :3]
    return Cloud(xyz, rgb, unit_normals(table[:, at : at + 3]) if columns.normals else None, notes)


def _notes(layout: _Layout, cloud: Cloud, file: str) -> tuple[str, ...]:
    """Say what was taken for what, where that is not plain, x, y, z in front with decimal points.

    It is a question where no header names the columns, and they were guessed.
    """
    x, y, z = (column + 1 for column in layout.used[:3])
    in_front = (x, y, z) == (1, 2, 3)
    if in_front and layout.dialect.decimal == ".":
        return ()
    marks = say("decimal_commas") if layout.dialect.decimal == "," else say("decimal_points")
    if in_front or layout.columns:
        return (say("columns_read", file=file, x=x, y=y, z=z, marks=marks),)
    return (with_values(say("columns_taken", file=file, x=x, y=y, z=z, marks=marks), cloud.of_table),)


def _left_out(reader: RowReader, count: int, file: str) -> tuple[str, ...]:
    dropped = reader.dropped
    return (say("rows_without_numbers_left_out", file=file, count=dropped, rows=count + dropped),) if dropped else ()


def named_columns(columns: dict[str, NDArray[Any]], file: str) -> Cloud:
    """Make a cloud from named columns of equal length; PLY, PCD, .npy and tables share these names."""
    columns = _by_meaning(columns, file)
    xyz = np.stack([columns[name].astype(np.float64) for name in _XYZ], axis=1)
    colours = first_present(columns, RGB)
    normals = first_present(columns, _NORMAL)
    rgb, notes = read_colours(colours, columns.get("intensity"))
    return Cloud(xyz, rgb, unit_normals(normals) if normals is not None else None, notes)


def _by_meaning(columns: dict[str, NDArray[Any]], file: str) -> dict[str, NDArray[Any]]:
    """Return the columns by what they are. Raises CAPTURE_UNREADABLE without x, y and z."""
    found = dict(zip(meanings(list(columns)), columns.values(), strict=True))
    if not all(name in found for name in _XYZ):
        raise _no_columns([*columns], file)
    return found


def first_present(columns: dict[str, NDArray[Any]], choices: tuple[tuple[str, ...], ...]) -> NDArray[Any] | None:
    """Return the columns (N,k) of the first choice whose names all exist, or None."""
    for names in choices:
        if all(name in columns for name in names):
            return np.stack([columns[name] for name in names], axis=1)
    return None


def _unnamed_columns(table: Floats, places: ColumnLayout) -> Cloud:
    """Make a cloud from columns without names: x y z, then colours and normals, told apart by their values."""
    colours, normals = (None if at is None else table[:, at : at + 3] for at in places)
    rgb, notes = read_colours(colours)
    return Cloud(table[:, :3], rgb, unit_normals(normals) if normals is not None else None, notes)


def unit_normals(vectors: NDArray[Any]) -> Floats:
    """Normalise vectors (N,3) to float32 of length 1; zero and non-finite vectors become 0."""
    floats = np.nan_to_num(vectors.astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
    length = np.linalg.norm(floats, axis=1, keepdims=True)
    unit: Floats = np.divide(floats, length, out=np.zeros_like(floats), where=length > 1e-12)
    return unit
