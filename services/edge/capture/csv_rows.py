"""Read a CSV whose first line names its columns."""

from __future__ import annotations

import csv

Row = dict[str, str]
"""Name of a column -> what a row has there; columns that a short row lacks are not in it."""


def csv_rows(text: str) -> list[Row]:
    """Return the rows of a CSV, without empty lines; blanks around names and before values are no part of them.

    Not csv.DictReader: it fills up every short row with the names of all columns, and a hostile header has a million.
    """
    reader = csv.reader(text.splitlines(), skipinitialspace=True)
    names = [name.strip() for name in next(reader, ())]
    return [dict(zip(names, row, strict=False)) for row in reader if row]
