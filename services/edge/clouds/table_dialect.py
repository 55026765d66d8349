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
_SIGN, _GROUP = "[-+\u2212]?", "[ \u00a0\u202f'\u2019]"
"""A minus may be typographic; what stands at the thousands, besides the mark that is not the decimals'."""
_NAN = rf"{_SIGN}(?:nan|inf(?:inity)?|1\.#\w+)(?:\(\w*\))?"
_POINT = re.compile(
    rf"{_SIGN}(?:\d+\.?\d*|\.\d+)(?:[ed][-+]?\d+)?|{_SIGN}\d{{1,3}}(?:(?:,|{_GROUP})\d{{3}})+\.\d+|{_NAN}", re.I
)
_COMMA = re.compile(
    rf"{_SIGN}(?:\d+,?\d*|,\d+)(?:[ed][-+]?\d+)?|{_SIGN}\d{{1,3}}(?:(?:\.|{_GROUP})\d{{3}})+,\d+|{_NAN}", re.I
)
_NO_MARKS = str.maketrans({**dict.fromkeys(" \u00a0\u202f'\u2019"), "\u2212": "-"})
_THOUSANDS = {mark: re.compile(rf"(?<=\d)(?<!\b0){re.escape(other)}(?=\d{{3}}(?!\d))") for mark, other in (".,", ",.")}
"""The mark at the thousands by the decimals': what stands elsewhere is none, or 4.5 among 4,25 would be 45."""
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
            return self._without_thousands(text).replace(",", ".") if self.separator != "," or self.quoted else text
        return self._without_thousands(text) if self.separator not in (",", "") else text

    def _without_thousands(self, text: str) -> str:
        return _THOUSANDS[self.decimal].sub("", text)

    def value(self, field: str) -> float | None:
        """Return a field's number; NaN where it is empty or says that there is none; None where it is a text."""
        if field.lower() in _NONE:
            return float("nan")
        try:
            bare = self._without_thousands(field.translate(_NO_MARKS) if self.is_number(field) else field)
            bare = bare.replace(",", ".") if self.decimal == "," else bare
            return float(bare.replace("d", "e").replace("D", "e"))
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
    is right with which more fields are numbers: whole ones, as of colours, are some with either.
    """
    quoted = any('"' in line for line in lines)
    for separator in _SEPARATORS:
        with_commas = separator != "" and (separator != "," or quoted)
        tried = [Dialect(separator, decimal, quoted) for decimal in (".," if with_commas else ".")]
        numbers = [[each.numbers(line) for line in lines] for each in tried]
        best = max(range(len(tried)), key=lambda at: sum(numbers[at]))
        if lines and sum(count >= _FEWEST for count in numbers[best]) >= _ENOUGH * len(lines):
            return tried[best]
    return None


def width_of(dialect: Dialect, lines: Sequence[str]) -> int:
    """Return how many fields most rows among some lines have, without an empty last one: many rows end with a
    separator, and their header does not."""
    rows = [dialect.fields(line) for line in lines if dialect.is_row(line)]
    counted = Counter(len(fields) - (not fields[-1]) for fields in rows)
    return counted.most_common(1)[0][0]
