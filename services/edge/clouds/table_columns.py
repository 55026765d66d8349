"""Find a table's columns: by the names in its header, or else by the values, after those that are no coordinates."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.clouds.column_names import meanings, metres_of
from capture2vr.edge.clouds.table_dialect import Dialect, is_remark
from capture2vr.order.reading import TableColumns

_POINTS = (("x", "y", "z"), ("longitude", "latitude", "z"))
_COLOURS = (("red", "green", "blue"), ("rf", "gf", "bf"))
_NORMALS = ("nx", "ny", "nz")
_SOME_NUMBERS = 0.5
"""Share of a column's fields that are numbers, from which on it is a column of numbers."""
_NAME = re.compile(r"[^\W\d]\w*(?: \w+)*(?:\s*[\[(].*[\])]|:\d+|\.\w+)?")
"""A column's name, which a word of a sentence with its marks is not."""
_ONE_BY_ONE = 0.8
"""Share of the steps that are one in a column that counts."""
_SECONDS = 1e8
"""A column that only rises, from such a number, has times: seconds since 1970, or of the satellites' clock."""


def named_by(header: Sequence[str], dialect: Dialect, width: int) -> tuple[TableColumns | None, list[str]]:
    """Return the columns that one of the lines above the rows names, the last one first, and the names that it has.

    A line that names no x, y and z names no columns, nor longitude, latitude and height. A remark does where it has as
    many names as there are columns: a sentence about x, y and z is none. R writes no name for the numbers of the rows.
    """
    for line in reversed(header):
        for names, shift in _readings(line, dialect, width):
            found = meanings(names)
            if (point := next((each for each in _POINTS if {*each} <= {*found}), None)) is not None:
                return _of_names(names, found, shift, point), found
            if {"latitude", "longitude"} <= {*found}:
                return None, found
    names = dialect.fields(header[-1]) if header and not is_remark(header[-1]) else []
    return None, names if len(names) == width and all(map(_NAME.fullmatch, names)) else []


def _readings(line: str, dialect: Dialect, width: int) -> Iterator[tuple[list[str], int]]:
    """Yield the names that a line may have, by one separator after the other, and the column that the first is of."""
    remark, text = is_remark(line), line.strip().lstrip("#/%! ")
    for separator in dict.fromkeys((dialect.separator, "\t", ";", ",", " ")):
        names = Dialect(separator, ".", '"' in text).fields(text)
        if len(names) in (width, width + 1) or not remark:  # the last column may be empty
            yield names, int(len(names) == width - 1)


def _of_names(names: Sequence[str], found: Sequence[str], shift: int, point: Sequence[str]) -> TableColumns:
    at = {meaning: number + shift for number, meaning in reversed(list(enumerate(found)))}

    def triple(wanted: Sequence[str]) -> tuple[int, ...]:
        return tuple(at[each] for each in wanted) if all(each in at for each in wanted) else ()

    degrees = point != _POINTS[0]
    units = {metres_of(names[at[axis] - shift]) for axis in (point[2:] if degrees else point)}
    return TableColumns(
        triple(point),
        triple(_COLOURS[0]) or triple(_COLOURS[1]),
        triple(_NORMALS),
        at["intensity"] if at.get("intensity", -1) > at[point[0]] else None,  # in front of them an "i" is an index
        units.pop() if len(units) == 1 else None,
        degrees,
    )


def without_names(rows: Sequence[Sequence[str]], dialect: Dialect) -> tuple[int, ...]:
    """Return the columns of numbers of a table without names, told by its first rows, from x on.

    Columns of texts and times are none of them, nor are leading ones that count the points, or a scan's rows and
    columns.
    """
    columns = dict(enumerate(zip(*rows, strict=False)))  # as many as the shortest row has
    values = {
        number: np.array([dialect.value(field) for field in fields], np.float64)
        for number, fields in columns.items()
        if sum(map(dialect.is_number, fields)) >= _SOME_NUMBERS * len(rows)
    }
    usable = [number for number, column in values.items() if not _are_times(column)]
    if len(usable) > 3 and _count(values[usable[0]]):
        return tuple(usable[1:])
    if len(usable) > 4 and _number_a_scan(*(values[number] for number in usable[:5])):
        return tuple(usable[2:])
    return tuple(usable)


def _are_times(column: Floats) -> bool:
    known = column[np.isfinite(column)]
    return len(known) > 2 and bool(known[0] > _SECONDS and (np.diff(known) >= 0).all())


def _count(column: Floats) -> bool:
    """Return whether each number (N,) is one more than the one before, or more where rows are missing."""
    step = np.diff(column)
    return len(column) > 2 and _are_whole(column) and bool((step >= 1).all() and np.mean(step == 1) > _ONE_BY_ONE)


def _number_a_scan(row: Floats, column: Floats, *xyz: Floats) -> bool:
    """Return whether two columns (N,) are the row and the column of each point (N,) of a scanner's grid.

    The row goes up by one, and within it the column goes up; both are whole numbers, and coordinates are not.
    """
    step = np.diff(row)
    if not ((step == 0) | (step == 1)).all() or any(_are_whole(axis) for axis in xyz):
        return False
    return _are_whole(row) and _are_whole(column) and bool((np.diff(column)[step == 0] > 0).all() and (step == 0).any())


def _are_whole(column: Floats) -> bool:
    return bool((column == np.rint(column)).all())
