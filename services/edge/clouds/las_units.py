"""Tell the unit of a LAS file's coordinates by its coordinate reference system, as WKT or as GeoTIFF keys.

LAS 1.4 specification R15, section 2.5 and table 22; GeoTIFF 1.1, section 7. The records are read here, not by laspy,
whose opening of a LAZ starts a decoder that may abort.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from capture2vr.edge.errors import CaptureError
from capture2vr.order.reading import METRES
from capture2vr.sentences.sentence import say

_USER = b"LASF_Projection"
_WKT, _KEYS = 2112, 34735
_MODEL, _LENGTH, _HEIGHT = 1024, 3076, 4099  # GTModelType, ProjLinearUnits, VerticalUnits
_GEOGRAPHIC = 2
_METRES = {9001: METRES["m"], 9002: METRES["ft"], 9003: METRES["us-ft"]}
_MOST_RECORDS, _MOST_BYTES = 1_000, 2**16
_UNIT = re.compile(r"\b(?:LENGTH)?UNIT\s*\[\s*\"[^\"]*\"\s*,\s*([\d.eE+-]+)")
_VERTICAL = re.compile(r"\bVERT(?:_CS|CRS|ICALCRS)\s*\[")
_PROJECTED = re.compile(r"\b(?:PROJCS|PROJCRS|PROJECTEDCRS|GEOCCS|LOCAL_CS|ENGCRS)\s*\[|CS\s*\[\s*Cartesian")
_ANGLES = re.compile(r"\b(?:GEOGCS|GEOGCRS|GEODCRS|GEOGRAPHICCRS)\s*\[")
_LEAST_LENGTH = 0.02  # of a unit in metres; a degree is .0175 in the units of angles


@dataclass(frozen=True, slots=True)
class LasUnits:
    """metres of one unit across and in height, and whether x and y are degrees."""

    across: float
    height: float
    degrees: bool = False


def las_units(path: Path) -> LasUnits | None:
    """Return the units that a LAS file names, None where it names none."""
    with path.open("rb") as stream:
        records = dict(_records(stream))
    if (text := records.get(_WKT)) and (found := units_of_wkt(text.split(b"\0")[0].decode("utf-8", "replace"))):
        return found
    return _units_of_keys(records[_KEYS]) if _KEYS in records else None


def _records(stream: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """Yield the numbers and contents of the records about the projection, before the points and behind them."""
    head = stream.read(375).ljust(375, b"\0")
    end = stream.seek(0, 2)
    stream.seek(struct.unpack_from("<H", head, 94)[0])
    yield from _listed(stream, min(struct.unpack_from("<I", head, 100)[0], _MOST_RECORDS), "<H16sHH32s", end)
    if head[24:26] >= b"\x01\x04":
        first, count = struct.unpack_from("<QI", head, 235)
        stream.seek(min(first, end))
        yield from _listed(stream, min(count, _MOST_RECORDS), "<H16sHQ32s", end)


def _listed(stream: BinaryIO, count: int, form: str, end: int) -> Iterator[tuple[int, bytes]]:
    """Yield the records of a list, as far as it lies in the file, which has `end` bytes."""
    size = struct.calcsize(form)
    for _ in range(count):
        head = stream.read(size)
        if len(head) < size:
            return
        _, user, number, length, _ = struct.unpack(form, head)
        following = stream.tell() + length
        if user.rstrip(b"\0") == _USER and number in (_WKT, _KEYS):
            yield number, stream.read(min(length, _MOST_BYTES))
        stream.seek(min(following, end))


def units_of_wkt(text: str) -> LasUnits | None:
    """Return the units of a coordinate reference system in well-known text, of either version; None without any."""
    vertical = _VERTICAL.search(text)
    plane, above = (text[: vertical.start()], text[vertical.start() :]) if vertical else (text, "")
    heights = _lengths(above)
    if _PROJECTED.search(plane):
        across = _lengths(plane)
        # The last one is that of the axes: those of the ellipsoid and of parameters come before.
        return LasUnits(across[-1], (heights or across)[-1]) if across else None
    return LasUnits(1.0, (heights or [1.0])[-1], degrees=True) if _ANGLES.search(plane) else None


def _lengths(text: str) -> list[float]:
    return [metres for each in _UNIT.findall(text) if (metres := _number(each)) >= _LEAST_LENGTH]


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return 0.0


def _units_of_keys(content: bytes) -> LasUnits | None:
    values = struct.unpack(f"<{len(content) // 2}H", content[: len(content) // 2 * 2])
    keys = {values[at]: values[at + 3] for at in range(4, len(values) - 3, 4) if values[at + 1] == 0}
    across = _METRES.get(keys.get(_LENGTH, 0))
    if keys.get(_MODEL) == _GEOGRAPHIC:
        return LasUnits(1.0, 1.0, degrees=True)
    return None if across is None else LasUnits(across, _METRES.get(keys.get(_HEIGHT, 0), across))


def las_metres(path: Path, name: str) -> float | None:
    """Return the metres of one unit across that a LAS names, None where it names none. Raises for degrees."""
    units = las_units(path)
    if units is not None and units.degrees:
        hint = say("project_degrees_to_metres")
        raise CaptureError("CAPTURE_UNREADABLE", say("has_coordinates_in_degrees"), file=name, hints=(hint,))
    return None if units is None else units.across
