"""Read the rows of a table into numbers: fast where they are as the others are, and one by one where they are not."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.clouds.table_dialect import Dialect, is_content
from capture2vr.order.reading import TableColumns

_BLOCK = 500  # lines that are read one by one where one of them is odd
NO_NUMBER = re.compile(r"[-+]?(?:1\.#\w+|nan\(\w*\))", re.I)
"""What programs write in place of a number that is none: 1.#IND by Microsoft's compiler, nan(ind) by others."""
_SHOWN_ROWS, _SHOWN_COLUMNS, _SHOWN_CHARACTERS = 4, 12, 16
"""Of a table that a person is asked about: what a phone's screen has room for. Columns that were taken come on top."""


@dataclass
class RowReader:
    """Reads the columns `used` of rows in one dialect; rows that have no numbers for the first three are left out.

    dropped  lines that were left out so far, but for empty ones, remarks, and lines that a count of points stands in
    """

    dialect: Dialect
    used: Sequence[int]
    dropped: int = 0
    _separator: str | None = field(init=False)

    def __post_init__(self) -> None:
        self._separator = self.dialect.separator.strip(" ") or None

    def read(self, text: str) -> Floats:
        """Return the numbers (N, used) of the rows in a piece of the table; NaN where one is missing."""
        text = NO_NUMBER.sub("nan", text) if "#" in text or "(" in text else text
        lines = text.split("\n")
        if (whole := self._fast(lines)) is not None:
            return whole
        blocks = [lines[start : start + _BLOCK] for start in range(0, len(lines), _BLOCK)]
        found = [self._fast(block) for block in blocks]
        read = [self._by_line(block) if rows is None else rows for rows, block in zip(found, blocks, strict=True)]
        return np.concatenate(read)

    def _fast(self, lines: Sequence[str]) -> Floats | None:
        """Return the numbers of lines that all are rows; None where one is not."""
        dialect = self.dialect
        if not any(map(str.strip, lines)):
            return np.empty((0, len(self.used)))
        if dialect.quoted and dialect.separator == "," and dialect.decimal == ",":
            return None
        try:
            return np.loadtxt(
                self._plain(lines),
                np.float64,
                comments=None,
                delimiter=self._separator,
                usecols=self.used,
                ndmin=2,
                quotechar='"' if dialect.quoted else None,
            )
        except ValueError:
            return None

    def _plain(self, lines: Sequence[str]) -> Iterable[str]:
        """Return lines with separators and numbers as NumPy reads them."""
        dialect = self.dialect
        if dialect.separator == "":
            return (line.replace(",", " ").replace(";", " ") for line in lines)
        if dialect.decimal == "," or (dialect.separator != "," and any("," in line for line in lines[:_BLOCK])):
            return map(dialect.as_python, lines)
        return lines

    def _by_line(self, lines: Sequence[str]) -> Floats:
        rows = list(self._rows(lines))
        return np.array(rows, np.float64).reshape(len(rows), len(self.used))

    def _rows(self, lines: Sequence[str]) -> Iterator[list[float | None]]:
        for line in lines:
            if not is_content(line):
                continue
            fields = self.dialect.fields(line)
            row = [self.dialect.value(fields[column]) if column < len(fields) else None for column in self.used]
            if None in row[:3]:
                self.dropped += 1
            else:
                yield row


def shown_rows(lines: Sequence[str], dialect: Dialect, columns: TableColumns) -> Mapping[str, Any]:
    """Return the first rows of a table for a person who says which column is which: `columns` as an option has them,
    `numbers` (from 1) of those that are shown, and `rows` of their cells.

    Of texts there is only a sign: what people wrote into a scan is nothing that its asset should tell.
    """
    rows = [dialect.fields(line) for line in lines[:_SHOWN_ROWS]]
    width = min(_SHOWN_COLUMNS, max(map(len, rows), default=0))
    numbers = sorted({*range(width), *columns.used})
    cells = [[_shown(row[number], dialect) if number < len(row) else "" for number in numbers] for row in rows]
    return {"columns": columns.as_text, "numbers": [number + 1 for number in numbers], "rows": cells}


def _shown(cell: str, dialect: Dialect) -> str:
    cut = cell if len(cell) <= _SHOWN_CHARACTERS else f"{cell[: _SHOWN_CHARACTERS - 1]}…"
    return cut if not cell or dialect.is_number(cell) else "…"
