"""Tell the colours and normals of a table without column names by their values: x y z come first, then anything."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from capture2vr.edge.arrays import Floats
from capture2vr.order.reading import TableColumns

_SAMPLE = 10_000  # rows that are looked at, evenly spaced; a file that is read in parts is not read for this
MOST_COLUMNS = 10  # that are looked at: x y z, an intensity, colours and normals
_LIKER = 0.2  # by which one correlation is surely higher: red and green have 0.9 and more, red and intensity 0.5


class ColumnLayout(NamedTuple):
    """The first column of the colours and of the normals, three columns each; None: the table has none."""

    colours: int | None
    normals: int | None

    def among(self, used: Sequence[int]) -> TableColumns:
        """Return the columns by their numbers in the file, of whose columns `used` are read."""
        colours, normals = (() if at is None else tuple(used[at : at + 3]) for at in self)
        return TableColumns(tuple(used[:3]), colours, normals)


def column_layout(table: NDArray[Any], *, counted: bool = False) -> ColumnLayout:
    """Tell where a table (N,k), k >= 3, has its colours and normals.

    Normals are three columns of unit vectors. Colours are the first three columns after x y z (or after normals that
    are there) of whole numbers 0 to 255, or the three that begin a column later, after an intensity. Where both are
    such numbers, the single column, first or last, is the one less like its neighbour; where that says nothing, the
    last, or the first in a .pts. Other colours, of 0 to 1 or 16 bits, are found in tables of 6 or 9 columns, and of 7
    or 10, whose fourth is then the intensity.

    counted: the number of points stands in the first line, as in a .pts, whose rows are x y z, intensity, colour
    """
    width = table.shape[1]
    some = np.asarray(table[:: max(1, len(table) // _SAMPLE), :MOST_COLUMNS], np.float64)
    usual = (4, 7) if width in (7, 10) else (3, 6)
    starts = [at for at in (*usual, 3, 6, 4, 7) if at + 3 <= some.shape[1]]
    normals = next((at for at in starts if _unit_length(some[:, at : at + 3])), None)
    free = starts if normals is None else [at for at in starts if abs(at - normals) >= 3]
    first = normals + 3 if normals in (3, 4) else 3
    colours = _byte_colours(some, first, free, unsure=counted and width == 7)
    return ColumnLayout(_other_colours(some, width, usual, free) if colours is None else colours, normals)


def _byte_colours(some: Floats, first: int, free: Sequence[int], *, unsure: bool) -> int | None:
    """Return the free column at which colours of whole numbers 0 to 255 begin: `first`, or the one after an intensity.

    unsure: whether the intensity comes first where nothing else tells
    """
    whole = [at for at in (first, first + 1) if at in free and _whole_bytes(some[:, at : at + 3])]
    if len(whole) == 2:
        return whole[_intensity_is_first(some[:, first : first + 4], unsure=unsure)]
    return next(iter(whole), None)


def _other_colours(some: Floats, width: int, usual: Sequence[int], free: Sequence[int]) -> int | None:
    """Return the usual column at which three columns without negative numbers begin, in a table of a usual width."""
    columns = [at for at in usual if at in free and width in (6, 7, 9, 10)]
    return next((at for at in columns if np.nanmin(some[:, at : at + 3], initial=0.0) >= 0), None)


def _unit_length(vectors: Floats) -> bool:
    """Return whether over 90 % of the rows have length 1 within 1 %, which colours do not have."""
    return bool(np.mean(np.abs(np.linalg.norm(vectors, axis=1) - 1.0) < 0.01) > 0.9)


def _whole_bytes(triple: Floats) -> bool:
    """Return whether three columns are whole numbers of 0 to 255, but for rows that are not finite."""
    known = triple[np.isfinite(triple).all(axis=1)]
    return bool(len(known) and ((known >= 0) & (known <= 255) & (known == np.rint(known))).all())


def _intensity_is_first(four: Floats, *, unsure: bool) -> bool:
    """Return whether the first of four columns is the intensity, and not the last: colours go up and down together.

    unsure: the answer where the correlations do not tell, as in a cloud of one colour
    """
    known = four[np.isfinite(four).all(axis=1)]
    centred = known - known.mean(axis=0) if len(known) else known
    length = np.linalg.norm(centred, axis=0)
    unit = np.divide(centred, length, out=np.zeros_like(centred), where=length > 0)
    difference = float(unit[:, 2] @ unit[:, 3] - unit[:, 0] @ unit[:, 1])
    return difference > 0 if abs(difference) > _LIKER else unsure
