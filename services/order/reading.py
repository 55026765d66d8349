"""How a file is read where it does not say so itself: what the columns of a table are, and the unit of coordinates."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

Unit = Literal["m", "cm", "mm", "in", "ft", "us-ft", "deg"]
"""Unit of a file's coordinates; us-ft: the foot of United States surveys; deg: longitude and latitude, heights in m."""

UnitName = Literal["", Unit]

METRES: Mapping[Unit, float] = {
    "m": 1.0,
    "cm": 0.01,
    "mm": 0.001,
    "in": 0.0254,
    "ft": 0.3048,
    "us-ft": 1200 / 3937,
    "deg": 1.0,  # they are projected to metres when they are read
}
"""Metres of one unit of the coordinates."""

MOST_CHARACTERS = 200
"""Of the columns, as text."""
_TRIPLES = (("x", "y", "z"), ("r", "g", "b"), ("nx", "ny", "nz"))
_NAMES = (*(name for names in _TRIPLES for name in names), "i")
_COLUMN = re.compile(rf"\s*({'|'.join(_NAMES)})\s*=\s*([1-9]\d{{0,3}})\s*")
HOW = "give the number of each column, from 1, such as x=2,y=3,z=4, and with colours r=5,g=6,b=7"
"""What to do about wrong columns."""


class InvalidColumns(ValueError):  # noqa: N818 - it reads as what it is
    """Columns that a table cannot have. The message is a sentence for people."""


@dataclass(frozen=True, slots=True)
class TableColumns:
    """Where a table has what: numbers of its columns, from 0.

    xyz, rgb, normals  three columns each; () where there are none
    intensity          None where there is none
    metres             length of the unit that the table's header names, of heights alone where x and y are degrees;
                       None where it names none
    degrees            whether the header names x and y longitude and latitude
    """

    xyz: tuple[int, ...]
    rgb: tuple[int, ...] = ()
    normals: tuple[int, ...] = ()
    intensity: int | None = None
    metres: float | None = None
    degrees: bool = False

    @property
    def used(self) -> tuple[int, ...]:
        """All of them, in the order xyz, rgb, normals, intensity."""
        return (*self.xyz, *self.rgb, *self.normals, *(() if self.intensity is None else (self.intensity,)))

    @property
    def as_text(self) -> str:
        """The columns as `parse` reads them."""
        triples = (self.xyz, self.rgb, self.normals, () if self.intensity is None else (self.intensity,))
        named = (pair for pairs in map(zip, (*_TRIPLES, ("i",)), triples) for pair in pairs)
        return ",".join(f"{name}={number + 1}" for name, number in named)

    @classmethod
    def parse(cls, text: str) -> TableColumns:
        """Parse numbers from 1 by name, such as "x=2,y=3,z=4": x y z, and r g b, nx ny nz or i for an intensity.

        Raises InvalidColumns.
        """
        if len(text) > MOST_CHARACTERS:
            raise InvalidColumns(f"the text has {len(text)} characters, at most {MOST_CHARACTERS} are read")
        pairs = [_pair_of(part) for part in text.lower().split(",")]
        found = dict(pairs)
        if not len(pairs) == len(found) == len({*found.values()}):
            raise InvalidColumns("a name or a number is there twice")
        xyz, rgb, normals = (tuple(found[name] for name in names if name in found) for names in _TRIPLES)
        if len(xyz) < 3 or any(len(triple) not in (0, 3) for triple in (rgb, normals)):
            raise InvalidColumns("x, y and z are needed, and colours and normals are three columns each")
        return cls(xyz, rgb, normals, found.get("i"))


def _pair_of(part: str) -> tuple[str, int]:
    """Return the name and the number, from 0, of a column such as "x=2"."""
    match = _COLUMN.fullmatch(part)
    if match is None:
        raise InvalidColumns(f"{part.strip()!r} is no column: the names are {', '.join(_NAMES)}")
    return match[1], int(match[2]) - 1


@dataclass(frozen=True, slots=True)
class FileReading:
    """What a person says of a file.

    columns  of a table, as `TableColumns.parse` reads them; "": as it seems
    unit     of the coordinates; "": as it seems
    """

    columns: str = ""
    unit: UnitName = ""


AS_IT_SEEMS = FileReading()
"""Nobody said anything."""
