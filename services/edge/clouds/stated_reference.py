"""Tell the coordinate reference system that a file states, and its unit: LAS, E57, or a .prj beside a file of points.

A LAS has it as WKT or as GeoTIFF keys:
LAS 1.4 specification R15, section 2.5 and table 22; GeoTIFF 1.1, section 7. The records are read here, not by laspy,
whose opening of a LAZ starts a decoder that may abort.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import BinaryIO

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.capture.files import Folder
from capture2vr.edge.clouds.e57 import e57_metadata
from capture2vr.edge.geodesy.reference_system import reference_of
from capture2vr.edge.geodesy.well_known_text import tidy
from capture2vr.order.reading import METRES

_USER = b"LASF_Projection"
_WKT, _KEYS = 2112, 34735
_MODEL, _LENGTH, _HEIGHT = 1024, 3076, 4099  # GTModelType, ProjLinearUnits, VerticalUnits
_PROJECTION, _GEOGRAPHIC = 1, 2
_MAP, _EARTH, _ABOVE = 3072, 2048, 4096  # codes of EPSG: ProjectedCSType, GeographicType, VerticalCSType
_LEAST_CODE, _NO_CODE = 1024, 32767  # from the last on a system is the user's own
_SAME = 1e-3  # share by which one unit may differ from another: the feet differ by 2e-6
_METRES = {9001: METRES["m"], 9002: METRES["ft"], 9003: METRES["us-ft"]}
_MOST_RECORDS, _MOST_BYTES = 1_000, 2**16
_UNIT = re.compile(r"\b(?:LENGTH)?UNIT\s*\[\s*\"[^\"]*\"\s*,\s*([\d.eE+-]+)")
_VERTICAL = re.compile(r"\bVERT(?:_CS|CRS|ICALCRS)\s*\[")
_PROJECTED = re.compile(r"\b(?:PROJCS|PROJCRS|PROJECTEDCRS|GEOCCS|LOCAL_CS|ENGCRS)\s*\[|CS\s*\[\s*Cartesian")
_ANGLES = re.compile(r"\b(?:GEOGCS|GEOGCRS|GEODCRS|GEOGRAPHICCRS)\s*\[")
_MOST_LONGITUDE = 360.0  # degrees: some count them from 0
_WIDEST = 10.0  # degrees that a survey spans at most
_LENGTHS = 0.02, 2_000.0  # of a unit in metres, up to a nautical mile; a degree is .0175 in the units of angles


@dataclass(frozen=True, slots=True)
class LasUnits:
    """metres of one unit across and in height, and whether x and y are degrees."""

    across: float
    height: float
    degrees: bool = False


@dataclass(frozen=True, slots=True)
class StatedReference:
    """What a file, or a person, states of its coordinates.

    crs      coordinate reference system, as well-known text or "EPSG:25832"; "" where none is stated
    units    of that; None where they are not stated
    guessed  whether the file states nothing of it, but its numbers look so
    """

    crs: str = ""
    units: LasUnits | None = None
    guessed: bool = False

    @property
    def in_degrees(self) -> bool:
        """Whether x and y are longitude and latitude."""
        return self.units is not None and self.units.degrees

    @property
    def metres(self) -> float | None:
        """Metres of one unit across; None where it is not stated."""
        return None if self.units is None else self.units.across

    def fitting(self, xyz: Floats) -> StatedReference:
        """Return the same; nothing where it states degrees, and points (N,3) are no longitudes and latitudes of a
        survey: programs write a default, such as WGS 84, into files with lengths."""
        known = xyz[np.isfinite(xyz).all(axis=1), :2]
        if not self.in_degrees or not len(known):
            return self
        low, high = np.percentile(known, (1, 99), axis=0)
        on_earth = np.abs([low, high]).max(axis=0) <= (_MOST_LONGITUDE, 90)
        return self if on_earth.all() and (high - low).max() <= _WIDEST else StatedReference()

    def in_unit_of(self, metres: float, *, degrees: bool = False) -> StatedReference:
        """Return the same in a unit that is stated elsewhere; without the system where that has another one."""
        same = self.metres is not None and self.in_degrees == degrees and abs(self.metres / metres - 1) < _SAME
        return self if same else StatedReference("", LasUnits(metres, metres, degrees))


GUESSED_DEGREES = StatedReference("", LasUnits(1.0, 1.0, degrees=True), guessed=True)
"""Of a table whose numbers look like longitudes, latitudes and heights in metres."""


def stated_reference(folder: Folder, name: str, kind: str) -> StatedReference:
    """Return what a LAS or E57, or a file .prj beside it, states of the coordinates; a person's unit goes first.

    Raises as `read_e57` does for a damaged file.
    """
    stated = _of_las(folder.path(name)) if kind == "las" else StatedReference()
    if kind == "e57":
        stated = StatedReference(tidy(e57_metadata(folder.path(name), name)), LasUnits(1.0, 1.0))
    if stated == StatedReference():
        stated = _beside(folder, name)
    unit = folder.reading.unit
    if unit:
        stated = stated.in_unit_of(METRES[unit], degrees=unit == "deg")
    known = reference_of(stated.crs)
    if known is None or stated.units is None:
        return stated
    return stated if stated.in_unit_of(known.metres, degrees=known.kind == "degrees").crs else replace(stated, crs="")


def _beside(folder: Folder, name: str) -> StatedReference:
    """Return what a file of the same name states that ends in .prj, as GIS programs write it."""
    wanted = str(PurePosixPath(name).with_suffix(".prj")).lower()
    found = next((each for each in folder.names if each.lower() == wanted), None)
    if found is None:
        return StatedReference()
    with folder.path(found).open("rb") as stream:
        text = tidy(stream.read(_MOST_BYTES).decode("utf-8-sig", "replace"))
    units = units_of_wkt(text)
    return StatedReference() if units is None else StatedReference(text, units)


def _of_las(path: Path) -> StatedReference:
    with path.open("rb") as stream:
        records = dict(_records(stream))
    text = records.get(_WKT, b"").split(b"\0")[0].decode("utf-8", "replace")
    if found := units_of_wkt(text):
        return StatedReference(tidy(text), found)
    return _of_keys(records[_KEYS]) if _KEYS in records else StatedReference()


def las_units(path: Path) -> LasUnits | None:
    """Return the units that a LAS file names, None where it names none."""
    return _of_las(path).units


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
    return [metres for each in _UNIT.findall(text) if _LENGTHS[0] <= (metres := _number(each)) <= _LENGTHS[1]]


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return 0.0


def _of_keys(content: bytes) -> StatedReference:
    """Return what GeoTIFF keys state: units, and a system that has a code."""
    values = struct.unpack(f"<{len(content) // 2}H", content[: len(content) // 2 * 2])
    keys = {values[at]: values[at + 3] for at in range(4, len(values) - 3, 4) if values[at + 1] == 0}
    code, above = keys.get(_MAP if keys.get(_MODEL) == _PROJECTION else _EARTH, 0), keys.get(_ABOVE, 0)
    crs = f"EPSG:{code}" if _LEAST_CODE <= code < _NO_CODE else ""
    crs += f"+{above}" if crs and _LEAST_CODE <= above < _NO_CODE else ""
    if keys.get(_MODEL) == _GEOGRAPHIC:
        return StatedReference(crs, LasUnits(1.0, 1.0, degrees=True))
    across = _METRES.get(keys.get(_LENGTH, 0))
    known = reference_of(crs)
    if across is None and known is not None and known.kind != "degrees":
        across = known.metres
    return StatedReference(crs, None if across is None else LasUnits(across, _METRES.get(keys.get(_HEIGHT, 0), across)))
