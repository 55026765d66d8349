"""Understand the text of a coordinate reference system: "EPSG:25832", "EPSG:25832+7837", or well-known text.

Known are geocentric coordinates, transverse Mercator, Lambert's conformal conic and degrees, on datums within two
metres of WGS 84. Of any other system the place on earth is not known.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Literal

from capture2vr.edge.geodesy.ellipsoid import FLATTENING, SEMI_MAJOR_M
from capture2vr.edge.geodesy.epsg_codes import DEGREES, GEOCENTRIC, projection_of
from capture2vr.edge.geodesy.projections import LambertConic, Projection, TransverseMercator
from capture2vr.edge.geodesy.well_known_text import CODE, WktNode, parse_wkt

_PROJECTED = "PROJCS", "PROJCRS", "PROJECTEDCRS"
_GEOCENTRIC = "GEOCCS", "GEODCRS", "GEODETICCRS"
_DEGREES = "GEOGCS", "GEOGCRS", "GEODCRS", "GEOGRAPHICCRS"
_DATUM = "DATUM", "ENSEMBLE", "GEODETICDATUM", "TRF"
_OTHER_DATUM = re.compile("ggrs|greek", re.IGNORECASE)  # on the ellipsoid of WGS 84, and 300 m away from it
_SHIFT_M = 3.0  # to WGS 84, from which on a datum is another one
_LINEAR, _ANGULAR = ("UNIT", "LENGTHUNIT"), ("UNIT", "ANGLEUNIT")
_DEGREE = math.radians(1)
# Letters of the names of parameters, of all versions of the text.
_LONGITUDE = "centralmeridian", "longitudeofcenter", "longitudeofnaturalorigin", "longitudeoffalseorigin"
_LATITUDE = "latitudeoforigin", "latitudeofcenter", "latitudeofnaturalorigin", "latitudeoffalseorigin"
_FIRST = "standardparallel1", "latitudeof1ststandardparallel"
_SECOND = "standardparallel2", "latitudeof2ndstandardparallel"
_SCALE = "scalefactor", "scalefactoratnaturalorigin"
_EAST, _NORTH = ("falseeasting", "eastingatfalseorigin"), ("falsenorthing", "northingatfalseorigin")
_TRANSVERSE = "transversemercator", "gausskruger"
_CONIC = {stem + which for stem in ("lambertconformalconic", "lambertconicconformal") for which in ("", "1sp", "2sp")}


@dataclass(frozen=True, slots=True)
class ReferenceSystem:
    """A coordinate reference system that is understood.

    kind        of its coordinates; metres: of one unit of theirs, 1 for degrees
    projection  of a map, None for the others
    """

    kind: Literal["map", "geocentric", "degrees"]
    metres: float = 1.0
    projection: Projection | None = None


def reference_of(text: str) -> ReferenceSystem | None:
    """Return the coordinate reference system of a text; None where it is not understood."""
    if code := CODE.fullmatch(text):
        return _of_code(int(code[1]))
    tree = parse_wkt(text)
    return None if tree is None else _of_tree(tree)


def _of_code(code: int) -> ReferenceSystem | None:
    if code in GEOCENTRIC:
        return ReferenceSystem("geocentric")
    if code in DEGREES:
        return ReferenceSystem("degrees")
    projection = projection_of(code)
    return None if projection is None else ReferenceSystem("map", projection=projection)


def _of_tree(tree: WktNode) -> ReferenceSystem | None:
    if not _is_of_wgs84(tree):
        return None
    if (projected := tree.first(*_PROJECTED)) is not None:
        metres = _factor(projected, _LINEAR)
        projection = None if metres is None else _projection(projected, metres)
        return None if metres is None or projection is None else ReferenceSystem("map", metres, projection)
    if (geocentric := tree.first(*_GEOCENTRIC)) is not None and _is_cartesian(geocentric):
        return ReferenceSystem("geocentric", _factor(geocentric, _LINEAR) or 1.0)
    return ReferenceSystem("degrees") if tree.first(*_DEGREES) is not None else None


def _is_of_wgs84(tree: WktNode) -> bool:
    """Return whether a datum is that of WGS 84 within some metres, as far as its ellipsoid and its shift tell."""
    ellipsoid, datum = tree.first("SPHEROID", "ELLIPSOID"), tree.first(*_DATUM)
    if ellipsoid is None or (datum is not None and any(map(_OTHER_DATUM.search, datum.values[:1]))):
        return False
    axis, inverse = ellipsoid.number(1) or 0.0, ellipsoid.number(2) or 0.0
    same = abs(axis - SEMI_MAJOR_M) < 0.1 and abs(inverse - 1 / FLATTENING) < 1e-3
    return same and not _is_moved(tree)


def _is_moved(tree: WktNode) -> bool:
    """Return whether longitudes count from elsewhere than Greenwich, or the earth's middle is elsewhere."""
    meridian, shift = tree.first("PRIMEM", "PRIMEMERIDIAN"), tree.first("TOWGS84")
    if meridian is not None and meridian.number() != 0:
        return True
    return shift is not None and any(abs(shift.number(at) or 0.0) > _SHIFT_M for at in range(3))


def _is_cartesian(system: WktNode) -> bool:
    """Return whether coordinates are geocentric: version 2 of the text says so by their kind of axes."""
    axes = system.own("CS")
    return system.keyword == "GEOCCS" or (axes is not None and axes.values[:1] == ["Cartesian"])


def _factor(system: WktNode, units: tuple[str, str]) -> float | None:
    """Return the metres or radians of a system's unit: its own, else that of its first axis; None without one."""
    axis = system.own("AXIS")
    unit = system.own(*units) or (axis.own(*units) if axis is not None else None)
    found = unit.number() if unit is not None else None
    return found if found is not None and 0 < found < math.inf else None


def _projection(system: WktNode, metres: float) -> Projection | None:
    """Return the projection that a system of well-known text describes, whose unit has so many metres."""
    method = system.first("PROJECTION", "METHOD")
    name = _letters(method.values[0]) if method is not None and method.values else ""
    values = _parameters(system, metres)
    if values is None:
        return None
    longitude, latitude = _found(values, _LONGITUDE, 0.0), _found(values, _LATITUDE, 0.0)
    scale, east, north = _found(values, _SCALE, 1.0), _found(values, _EAST, 0.0), _found(values, _NORTH, 0.0)
    if name in _TRANSVERSE:
        return TransverseMercator(longitude, latitude, scale, east, north)
    if name not in _CONIC:
        return None
    first = _found(values, _FIRST, latitude)
    conic = LambertConic(longitude, latitude, (first, _found(values, _SECOND, first)), scale, east, north)
    # A cone between parallels on either side of the equator is a cylinder.
    return conic if abs(sum(conic.parallels)) > 1e-3 else None


def _parameters(system: WktNode, metres: float) -> dict[str, float] | None:
    """Return the parameters of a projection by the letters of their names, in radians and metres; None for nonsense."""
    base = system.first(*_DEGREES, "BASEGEOGCRS", "BASEGEODCRS")
    radians = (_factor(base, _ANGULAR) if base is not None else None) or _DEGREE
    values = {}
    for parameter in system.all_of("PARAMETER"):
        name, number = _letters("".join(parameter.values[:1])), parameter.number()
        if number is None or not math.isfinite(number):
            return None
        usual = 1.0 if name in _SCALE else metres if name in (*_EAST, *_NORTH) else radians
        values[name] = number * _unit_of(parameter, usual)
    return values if all(abs(values.get(name, 0.0)) <= 2 * math.pi for name in (*_LONGITUDE, *_LATITUDE)) else None


def _unit_of(parameter: WktNode, usual: float) -> float:
    """Return the radians or metres of a parameter's unit, which version 2 of the text has at each of them."""
    unit = parameter.own("LENGTHUNIT", "ANGLEUNIT", "SCALEUNIT", "UNIT")
    return usual if unit is None else unit.number() or usual


def _letters(name: str) -> str:
    return re.sub(r"[^a-z\d]", "", name.lower())


def _found(values: dict[str, float], names: tuple[str, ...], otherwise: float) -> float:
    return next((values[name] for name in names if name in values), otherwise)
