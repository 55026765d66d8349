"""Tell how a table of numbers is written: what separates its fields, and which mark its decimals have."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

_REMARKS = ("#", "//", "%", "!")
_NONE = ("", "na", "n/a", "null", "none", "-", "nodata")
"""What programs write for no number."""
_SEPARATORS = ("\t", ";", "|", ",", " ", "")
"""In the order in which they are tried: " " stands for any blanks, "" for blanks, commas and semicolons alike."""
_FEWEST = 3
"""Numbers in a row: x, y and z."""
_ENOUGH = 0.5
"""Share of the lines that are such rows: the others are headers, remarks and counts."""
_NAN = r"[-+]?(?:nan|inf(?:inity)?|1\.#\w+)(?:\(\w*\))?"
_POINT = re.compile(rf"[-+]?(?:\d+\.?\d*|\.\d+)(?:[ed][-+]?\d+)?|[-+]?\d{{1,3}}(?:,\d{{3}})+\.\d+|{_NAN}", re.I)
_COMMA = re.compile(rf"[-+]?(?:\d+,?\d*|,\d+)(?:[ed][-+]?\d+)?|[-+]?\d{{1,3}}(?:\.\d{{3}})+,\d+|{_NAN}", re.I)
_GLUED = re.compile(r"[-+.\d]*\d(?:[;,|\s]+[-+]?[.\d]+)+[;,|\s]*")
"""Several numbers: a field like that is cut at the wrong separator."""
_ANY = re.compile(r"[\s,;]+")


@dataclass(frozen=True, slots=True)
class Dialect:
    """How rows are written.

    separator  of the fields: one of `_SEPARATORS`
    decimal    mark: "." or ","
    quoted     whether fields have quotation marks
    """

    separator: str
    decimal: str
    quoted: bool

    def fields(self, line: str) -> list[str]:
        """Split a line; fields without the blanks and quotation marks around them."""
        if self.separator == "":
            return _ANY.split(line.strip(" \t,;"))
        if self.separator == " ":
            return [field.strip('"') for field in line.split()]
        if '"' in line:
            line = line.strip()
            return [field.strip(' "') for field in next(csv.reader([line], delimiter=self.separator), [])]
        return [field.strip() for field in line.rstrip("\n").split(self.separator)]

    def is_number(self, field: str) -> bool:
        """Return whether a field is a number, or what programs write for none: NaN, inf, 1.#IND."""
        return (_POINT if self.decimal == "." else _COMMA).fullmatch(field) is not None

    def as_python(self, text: str) -> str:
        """Write the numbers in a text as Python reads them."""
        if self.decimal == ",":
            return text.replace(".", "").replace(",", ".") if self.separator != "," or self.quoted else text
        return text.replace(",", "") if self.separator not in (",", "") and "," in text else text

    def value(self, field: str) -> float | None:
        """Return a field's number; NaN where it is empty or says that there is none; None where it is a text."""
        if field.lower() in _NONE:
            return float("nan")
        try:
            return float(self.as_python(field).replace("d", "e").replace("D", "e"))
        except ValueError:
            return None

    def numbers(self, line: str) -> int:
        """Return how many of a line's fields are numbers; none where one field is several numbers."""
        fields = self.fields(line)
        if any(_GLUED.fullmatch(field) and not self.is_number(field) for field in fields):
            return 0
        return sum(map(self.is_number, fields))

    def is_row(self, line: str) -> bool:
        """Return whether a line has the numbers of a point."""
        return self.numbers(line) >= _FEWEST


def is_remark(line: str) -> bool:
    """Return whether a line is a remark."""
    return line.strip().startswith(_REMARKS)


def is_content(line: str) -> bool:
    """Return whether a line is more than empty, a remark, or the number of points, which stands above a scan's rows."""
    return bool(bare := line.strip()) and not is_remark(bare) and not bare.isdigit()


def dialect_of(lines: Sequence[str]) -> Dialect | None:
    """Tell how the rows among some lines of a table are written; None where they are no rows of numbers.

    A separator is right where no field is several numbers, and "4,830<tab>3,232" are two of them; then a decimal mark
    is right with which the fields are numbers.
    """
    quoted = any('"' in line for line in lines)
    for separator in _SEPARATORS:
        for decimal in ".,":
            if decimal == "," and (separator == "" or (separator == "," and not quoted)):
                continue
            tried = Dialect(separator, decimal, quoted)
            if lines and sum(map(tried.is_row, lines)) >= _ENOUGH * len(lines):
                return tried
    return None


def width_of(dialect: Dialect, lines: Sequence[str]) -> int:
    """Return how many fields most rows among some lines have."""
    counted = Counter(len(dialect.fields(line)) for line in lines if dialect.is_row(line))
    return counted.most_common(1)[0][0]
