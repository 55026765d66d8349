"""Tables of points as scanners, spreadsheets and survey software write them: valid, odd, and with known points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from random import Random
from typing import Any

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
    ("X [mm]", "Y [mm]", "Z [mm]"),
    ("x(ft)", "y(ft)", "z(ft)"),
)
METRES = {"X [mm]": 0.001, "x(ft)": 0.3048}
COLOURS = {"x": ("R", "G", "B"), "Rechtswert": ("Rot", "Grün", "Blau"), "Points:0": ("RGB:0", "RGB:1", "RGB:2")}
FRONT = ("", "index", "name", "time", "seconds", "row and column")
NO_NUMBER = ("nan", "NaN", "-1.#IND", "1.#QNAN", "-nan(ind)", "inf", "")


@dataclass(frozen=True)
class OddTable:
    """One way to write a table.

    front  columns before x; hollow: an empty column behind x; nothing: what stands for the numbers of every 20th row
    before, after  lines above and below the rows; trailing: what is behind each row; number: of coordinates
    shades         "bytes", or "fractions" of 255
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
    number: str = ".4f"
    shades: str = "bytes"
    odd_rows: tuple[str, ...] = field(default=())

    @property
    def metres(self) -> float:
        """Metres of one of its numbers, by the unit that its header names."""
        return METRES.get(self.header[0], 1.0) if self.header else 1.0

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
        values = [format(value, self.number).replace(".", self.decimal) for value in point]
        if number % 20 == 7:
            values = [self.nothing] * 3
        if self.hollow:
            values.insert(1, "")
        shown = [self._shade(value) for value in colour] if self.coloured else []
        return self.separator.join(map(self._field, (*self._front(number), *values, *shown))) + self.trailing

    def _shade(self, value: int) -> str:
        return str(value) if self.shades == "bytes" else f"{value / 255:.5f}".replace(".", self.decimal)

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


CHOICES: dict[str, Sequence[Any]] = {
    "encoding": ("utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "cp1252"),
    "separator": ("\t", ";", "|", ",", ", ", " ", "; "),
    "decimal": ".,",
    "header": ((), *HEADERS),
    "remark": ("", "", "#", "// "),
    "front": FRONT,
    "coloured": (False, True),
    "hollow": (False, True),
    "quoted": (False, True),
    "nothing": NO_NUMBER,
    "ends": ("\n", "\r\n", "\r"),
    "before": ((), ("Project: Müller & Söhne",), ("# a scan", "# of 2026"), ("Scan 3", "")),
    "after": ((), ("", ""), ("End of file",), ("# 400 points",)),
    "trailing": ("", "", " ", "\t"),
    "number": (".4f", ".4f", "12.4f", "+.4f", ".10e"),
    "shades": ("bytes", "bytes", "fractions"),
    "odd_rows": ((), ("1.5",), ("a remark between rows",)),
}
odd_tables = st.builds(OddTable, **{name: st.sampled_from(choices) for name, choices in CHOICES.items()}).filter(
    is_possible
)


def odd_table(chance: Random) -> OddTable:
    """Return a table that is drawn by `chance`."""
    while not is_possible(table := OddTable(**{name: chance.choice(choices) for name, choices in CHOICES.items()})):
        pass
    return table
