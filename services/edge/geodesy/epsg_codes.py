"""Coordinate reference systems by their EPSG codes, those in which surveys are mostly delivered; all are in metres.

Source: the EPSG Geodetic Parameter Dataset. Their datums are those of WGS 84 within two metres; older ones, some
hundred metres off, are not here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from capture2vr.edge.geodesy.projections import LambertConic, Projection, TransverseMercator

_NORTH, _SOUTH = 0.0, 10_000_000.0  # added to the northings of UTM, in metres
# First and last code of consecutive zones of UTM, the first one's zone, and the hemisphere.
_UTM = (
    (32601, 32660, 1, _NORTH),  # WGS 84
    (32701, 32760, 1, _SOUTH),
    (25828, 25838, 28, _NORTH),  # ETRS89
    (26901, 26923, 1, _NORTH),  # NAD83
    (6330, 6348, 1, _NORTH),  # NAD83(2011)
    (28348, 28358, 48, _SOUTH),  # GDA94, Map Grid of Australia
    (7846, 7859, 46, _SOUTH),  # GDA2020
    (31965, 31976, 11, _NORTH),  # SIRGAS 2000
    (31977, 31985, 17, _SOUTH),
    (6688, 6692, 51, _NORTH),  # JGD2011
    (3067, 3067, 35, _NORTH),  # Finland
    (3006, 3006, 33, _NORTH),  # Sweden
)
_WITH_ZONE = {4647: 32, 5649: 31, 5650: 33, 5651: 31, 5652: 32, 5653: 33}  # UTM with the zone before the easting
# Transverse Mercator: degrees of longitude and latitude of the origin, its scale, metres east and north.
_TRANSVERSE = {
    2157: (-8.0, 53.5, 0.99982, 600_000.0, 750_000.0),  # Ireland
    2180: (19.0, 0.0, 0.9993, 500_000.0, -5_300_000.0),  # Poland
    2193: (173.0, 0.0, 0.9996, 1_600_000.0, 10_000_000.0),  # New Zealand
    3059: (24.0, 0.0, 0.9996, 500_000.0, -6_000_000.0),  # Latvia
    3346: (24.0, 0.0, 0.9998, 500_000.0, 0.0),  # Lithuania
    3763: (-(8 + 7.0 / 60 + 59.19 / 3600), 39 + 40.0 / 60 + 5.73 / 3600, 1.0, 0.0, 0.0),  # Portugal
    3765: (16.5, 0.0, 0.9999, 500_000.0, 0.0),  # Croatia
    3794: (15.0, 0.0, 0.9999, 500_000.0, -5_000_000.0),  # Slovenia
}
# Lambert's conic: degrees of longitude and latitude of the origin and of two parallels, metres east and north.
_CONICS = {
    2154: (3.0, 46.5, 49.0, 44.0, 700_000.0, 6_600_000.0),  # France
    3034: (10.0, 52.0, 35.0, 65.0, 4_000_000.0, 2_800_000.0),  # Europe
    3301: (24.0, 57 + 31.0 / 60 + 3.19415 / 3600, 59 + 20.0 / 60, 58.0, 500_000.0, 6_375_000.0),  # Estonia
    3416: (13 + 20.0 / 60, 47.5, 49.0, 46.0, 400_000.0, 400_000.0),  # Austria
    3812: (4 + 21 / 60 + 33.177 / 3600, 50 + 47 / 60 + 52.134 / 3600, 49 + 5 / 6, 51 + 1 / 6, 649_328.0, 665_262.0),
} | {3900 + at: (3.0, at, at - 0.75, at + 0.75, 1_700_000.0, (at - 41) * 1e6 + 200_000.0) for at in range(42, 51)}
GEOCENTRIC = frozenset({4919, 4936, 4964, 4978, 6317, 7789, 7842, 9988})
"""Codes of geocentric coordinates."""
DEGREES = frozenset(
    {4167, 4171, 4258, 4269, 4283, 4326, 4490, 4612, 4674, 4937, 4979, 6318, 6319, 6668, 7843, 7844, 9000}
)
"""Codes of longitude and latitude, with and without heights."""
_NORWAY = range(5105, 5131)  # one zone a degree of longitude, from 5.5° on
_SWEDEN: Mapping[int, float] = dict(
    zip(range(3007, 3019), (12, 13.5, 15, 16.5, 18, 14.25, 15.75, 17.25, 18.75, 20.25, 21.75, 23.25), strict=True)
)


def projection_of(code: int) -> Projection | None:
    """Return the map projection of an EPSG code; None where it is none of these."""
    for first, last, zone, north_m in _UTM:
        if first <= code <= last:
            return utm(zone + code - first, north_m)
    if code in _WITH_ZONE:
        return utm(_WITH_ZONE[code], east_m=1e6 * _WITH_ZONE[code] + 500_000)
    if code in _NORWAY:
        return TransverseMercator(math.radians(code - 5099.5), math.radians(58), 1.0, 100_000, 1_000_000)
    if code in _SWEDEN:
        return TransverseMercator(math.radians(_SWEDEN[code]), 0.0, 1.0, 150_000)
    if code in _TRANSVERSE:
        longitude, latitude, scale, *added = _TRANSVERSE[code]
        return TransverseMercator(math.radians(longitude), math.radians(latitude), scale, *added)
    if code in _CONICS:
        longitude, latitude, first_deg, second_deg, *added = _CONICS[code]
        parallels = math.radians(first_deg), math.radians(second_deg)
        return LambertConic(math.radians(longitude), math.radians(latitude), parallels, 1.0, *added)
    return None


def utm(zone: int, north_m: float = _NORTH, *, east_m: float = 500_000.0) -> TransverseMercator:
    """Return the projection of a zone of UTM, 1 to 60; north_m, east_m: what is added to coordinates."""
    return TransverseMercator(math.radians(6 * zone - 183), 0.0, 0.9996, east_m, north_m)
