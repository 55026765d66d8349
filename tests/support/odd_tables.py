"""Tables of points as scanners, spreadsheets and survey software write them: valid, odd, and with known points."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta

import numpy as np
from hypothesis import strategies as st

HEADERS = (
    ("x", "y", "z"),
    ("X [m]", "Y [m]", "Z [m]"),
    ("X(m)", "Y(m)", "Z(m)"),
    ("Easting", "Northing", "Elevation"),
    ("Rechtswert", "Hochwert", "Höhe"),
    ("Points:0", "Points:1", "Points:2"),
    ("coord. x", "coord. y", "coord. z"),
    ("Este", "Norte", "Cota"),
)
COLOURS = {"x": ("R", "G", "B"), "Rechtswert": ("Rot", "Grün", "Blau"), "Points:0": ("RGB:0", "RGB:1", "RGB:2")}
FRONT = ("", "index", "name", "time", "seconds", "row and column")
NO_NUMBER = ("nan", "NaN", "-1.#IND", "1.#QNAN", "-nan(ind)", "inf", "")


@dataclass(frozen=True)
class OddTable:
    """One way to write a table.

    front  columns before x; hollow: an empty column behind x; nothing: what stands for the numbers of every 20th row
    before, after  lines above and below the rows
    """

    encoding: str = "utf-8"
    separator: str = " "
    decimal: str = "."
    header: tuple[str, ...] = ()
    remark: str = ""
    front: str = ""
    coloured: bool = True
    hollow: bool = False
    quoted: bool = False
    nothing: str = "nan"
    ends: str = "\n"
    before: tuple[str, ...] = ()
    after: tuple[str, ...] = ()
    trailing: str = ""
    odd_rows: tuple[str, ...] = field(default=())

    def written(self, xyz: np.ndarray, rgb: np.ndarray) -> bytes:
        """The bytes of a table of points (N,3) and colours (N,3)."""
        lines = [*self.before]
        if self.header:
            lines.append(self.remark + self.separator.join(self._names()))
        for number, (point, colour) in enumerate(zip(xyz.tolist(), rgb.tolist(), strict=True)):
            lines.append(self._row(number, point, colour))
        lines[len(lines) // 2 : len(lines) // 2] = self.odd_rows
        text = self.ends.join([*lines, *self.after]) + self.ends
        mark = "\ufeff" if self.encoding in ("utf-16-le", "utf-16-be") and self.remark == "" else ""
        return (mark + text).encode(self.encoding)

    def _names(self) -> list[str]:
        fronts = {"": [], "row and column": ["Row", "Column"], "index": [""]}.get(self.front, [self.front])
        colours = COLOURS.get(self.header[0], ("red", "green", "blue")) if self.coloured else ()
        x, *others = self.header
        return [self._field(name) for name in (*fronts, x, *([""] if self.hollow else []), *others, *colours)]

    def _row(self, number: int, point: list[float], colour: list[int]) -> str:
        values = [f"{value:.4f}".replace(".", self.decimal) for value in point]
        if number % 20 == 7:
            values = [self.nothing] * 3
        if self.hollow:
            values.insert(1, "")
        shown = [str(value) for value in colour] if self.coloured else []
        return self.separator.join(map(self._field, (*self._front(number), *values, *shown))) + self.trailing

    def _front(self, number: int) -> list[str]:
        when = datetime(2026, 3, 1, tzinfo=UTC) + timedelta(seconds=number / 10)
        return {
            "": [],
            "index": [str(number)],
            "name": [f"P{number:05d}a"],
            "time": [f"{when:%H:%M:%S.%f}"],
            "seconds": [f"{when.timestamp():.2f}".replace(".", self.decimal)],
            "row and column": [str(number // 20), str(number % 20)],
        }[self.front]

    def _field(self, text: str) -> str:
        return f'"{text}"' if self.quoted else text


def is_possible(table: OddTable) -> bool:
    """Return whether a reader could tell the points: blanks cannot enclose nothing, nor commas decimal commas."""
    blank = not table.separator.strip()
    names = (*table.header, *COLOURS.get(table.header[0], ())) if table.header else ()
    if table.separator == " " and (table.hollow or table.nothing == "" or any(" " in name for name in names)):
        return False
    if table.separator == " " and table.header and table.front == "index":
        return False
    if table.decimal == "," and table.separator.strip() == ",":
        return False
    if table.hollow and not table.header:
        return False
    return not (table.quoted and blank)


odd_tables = st.builds(
    OddTable,
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "cp1252"]),
    separator=st.sampled_from(["\t", ";", "|", ",", ", ", " ", "; "]),
    decimal=st.sampled_from(".,"),
    header=st.sampled_from([(), *HEADERS]),
    remark=st.sampled_from(["", "", "#", "// "]),
    front=st.sampled_from(FRONT),
    coloured=st.booleans(),
    hollow=st.booleans(),
    quoted=st.booleans(),
    nothing=st.sampled_from(NO_NUMBER),
    ends=st.sampled_from(["\n", "\r\n", "\r"]),
    before=st.sampled_from([(), ("Project: Müller & Söhne",), ("# a scan", "# of 2026"), ("Scan 3", "")]),
    after=st.sampled_from([(), ("", ""), ("End of file",), ("# 400 points",)]),
    trailing=st.just(""),
    odd_rows=st.sampled_from([(), ("1.5",), ("a remark between rows",)]),
).filter(is_possible)
