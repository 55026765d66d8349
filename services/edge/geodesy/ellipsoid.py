"""The ellipsoid of WGS 84: geocentric coordinates (ECEF, EPSG:4978), and conformal latitudes for map projections."""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Floats

SEMI_MAJOR_M, FLATTENING = 6_378_137.0, 1 / 298.257223563
"""Of WGS 84. GRS 80, the ellipsoid of ETRS89 and NAD83, has the same but for 0.1 mm at the poles."""
_SQUARED = FLATTENING * (2 - FLATTENING)  # of the eccentricity
ECCENTRICITY = _SQUARED**0.5
_ROUNDS = 6  # of Newton's method, of which three suffice for a nanometre


def to_ecef(longitude: Floats, latitude: Floats, height_m: Floats) -> Floats:
    """Convert longitudes and latitudes (N,) in radians and ellipsoidal heights to geocentric coordinates (N,3), m."""
    across = SEMI_MAJOR_M / np.sqrt(1 - _SQUARED * np.sin(latitude) ** 2)
    from_axis = (across + height_m) * np.cos(latitude)
    along = (across * (1 - _SQUARED) + height_m) * np.sin(latitude)
    return np.stack([from_axis * np.cos(longitude), from_axis * np.sin(longitude), along], axis=-1)


def conformal(latitude: Floats) -> Floats:
    """Return the tangents of the conformal latitudes (N,) of latitudes in radians.

    C. F. F. Karney, "Transverse Mercator with an accuracy of a few nanometers", J. Geodesy 85 (2011), equations 7 to 9.
    """
    return _conformal_of_tangent(np.tan(np.clip(latitude, -np.pi / 2, np.pi / 2)))


def _conformal_of_tangent(tangent: Floats) -> Floats:
    root = np.sqrt(1 + tangent**2)
    turn = np.sinh(ECCENTRICITY * np.arctanh(ECCENTRICITY * tangent / root))
    return np.asarray(tangent * np.sqrt(1 + turn**2) - turn * root)


def from_conformal(conformal_tangent: Floats) -> Floats:
    """Return the latitudes (N,) in radians of the tangents of conformal ones, by Newton's method (Karney, 19 to 21)."""
    tangent = conformal_tangent / (1 - _SQUARED)
    for _ in range(_ROUNDS):
        reached = _conformal_of_tangent(tangent)
        slope = (1 - _SQUARED) * np.sqrt(1 + reached**2) * np.sqrt(1 + tangent**2) / (1 + (1 - _SQUARED) * tangent**2)
        tangent = tangent + (conformal_tangent - reached) / slope
    return np.asarray(np.arctan(tangent))
