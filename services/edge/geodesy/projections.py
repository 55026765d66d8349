"""Map projections on the ellipsoid of WGS 84: transverse Mercator (UTM among them) and Lambert's conformal conic.

Angles are in radians, lengths in metres. Both are exact to less than 0.1 mm where they are used: transverse Mercator
within 3,000 km of its central meridian, the conic anywhere but at the pole that it does not open towards.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.geodesy.ellipsoid import ECCENTRICITY, FLATTENING, SEMI_MAJOR_M, conformal, from_conformal


class Projection(Protocol):
    """A map projection."""

    def forward(self, longitude: Floats, latitude: Floats) -> tuple[Floats, Floats]:
        """Project longitudes and latitudes (N,) -> east and north (N,)."""
        ...

    def inverse(self, east: Floats, north: Floats) -> tuple[Floats, Floats]:
        """Return the longitudes and latitudes (N,) of places (N,) on the map."""
        ...


# Krüger's series in the third flattening, to its fourth power: Karney (2011), equations 14, 35 and 36.
_N = FLATTENING / (2 - FLATTENING)
_RADIUS_M = SEMI_MAJOR_M / (1 + _N) * (1 + _N**2 / 4 + _N**4 / 64)
_TO_MAP = (
    _N / 2 - 2 * _N**2 / 3 + 5 * _N**3 / 16 + 41 * _N**4 / 180,
    13 * _N**2 / 48 - 3 * _N**3 / 5 + 557 * _N**4 / 1440,
    61 * _N**3 / 240 - 103 * _N**4 / 140,
    49561 * _N**4 / 161280,
)
_FROM_MAP = (
    _N / 2 - 2 * _N**2 / 3 + 37 * _N**3 / 96 - _N**4 / 360,
    _N**2 / 48 + _N**3 / 15 - 437 * _N**4 / 1440,
    17 * _N**3 / 480 - 37 * _N**4 / 840,
    4397 * _N**4 / 161280,
)


@dataclass(frozen=True, slots=True)
class TransverseMercator:
    """Transverse Mercator, also called Gauss-Krüger: its origin in radians, the scale there, and what is added in m."""

    longitude: float
    latitude: float = 0.0
    scale: float = 1.0
    east_m: float = 0.0
    north_m: float = 0.0

    def forward(self, longitude: Floats, latitude: Floats) -> tuple[Floats, Floats]:
        """Project longitudes and latitudes (N,) -> east and north (N,)."""
        place = self._on_sphere(longitude - self.longitude, latitude)
        from_equator = self._on_sphere(np.zeros(1), np.array([self.latitude]))[0].real
        radius = self.scale * _RADIUS_M
        return self.east_m + radius * place.imag, self.north_m + radius * (place.real - from_equator)

    def inverse(self, east: Floats, north: Floats) -> tuple[Floats, Floats]:
        """Return the longitudes and latitudes (N,) of places (N,) on the map."""
        from_equator = self._on_sphere(np.zeros(1), np.array([self.latitude]))[0].real
        radius = self.scale * _RADIUS_M
        mapped = from_equator + (north - self.north_m) / radius + 1j * (east - self.east_m) / radius
        place = mapped - sum(factor * np.sin(2 * (power + 1) * mapped) for power, factor in enumerate(_FROM_MAP))
        across, along = np.sinh(place.imag), np.cos(place.real)
        latitude = from_conformal(np.sin(place.real) / np.hypot(across, along))
        return self.longitude + np.arctan2(across, along), latitude

    @staticmethod
    def _on_sphere(from_middle: Floats, latitude: Floats) -> Floats:
        """Return places in units of the rectifying radius, as complex numbers: north + i east."""
        tangent = conformal(latitude)
        across = np.arcsinh(np.sin(from_middle) / np.hypot(tangent, np.cos(from_middle)))
        place = np.arctan2(tangent, np.cos(from_middle)) + 1j * across
        return np.asarray(place + sum(factor * np.sin(2 * (power + 1) * place) for power, factor in enumerate(_TO_MAP)))


@dataclass(frozen=True, slots=True)
class LambertConic:
    """Lambert's conformal conic with one or two standard parallels (radians), which are equal where there is one.

    J. P. Snyder, "Map Projections: A Working Manual", USGS Professional Paper 1395 (1987), equations 15-1 to 15-11,
    with isometric latitudes in place of his t.
    """

    longitude: float
    latitude: float
    parallels: tuple[float, float]
    scale: float = 1.0
    east_m: float = 0.0
    north_m: float = 0.0

    def forward(self, longitude: Floats, latitude: Floats) -> tuple[Floats, Floats]:
        """Project longitudes and latitudes (N,) -> east and north (N,)."""
        cone, _ = self._cone()
        turn = cone * (np.mod(longitude - self.longitude + np.pi, 2 * np.pi) - np.pi)
        away, origin = self._from_pole(latitude), self._from_pole(np.array([self.latitude]))
        return self.east_m + away * np.sin(turn), self.north_m + origin - away * np.cos(turn)

    def inverse(self, east: Floats, north: Floats) -> tuple[Floats, Floats]:
        """Return the longitudes and latitudes (N,) of places (N,) on the map."""
        cone, factor = self._cone()
        side = np.sign(cone)
        across, along = side * (east - self.east_m), side * (self._from_pole(np.array([self.latitude])) - north)
        along = along + side * self.north_m
        isometric = (np.log(factor) - np.log(np.hypot(across, along))) / cone
        return self.longitude + np.arctan2(across, along) / cone, from_conformal(np.sinh(isometric))

    def _cone(self) -> tuple[float, float]:
        """Return the constant of the cone, and the length of what is `abs(isometric)` = 0 from its tip, in metres."""
        parallels = np.array(self.parallels)
        isometric, (first, second) = np.arcsinh(conformal(parallels)), parallels
        radii = np.cos(parallels) / np.sqrt(1 - (ECCENTRICITY * np.sin(parallels)) ** 2)
        differ = abs(first - second) > 1e-10
        cone = np.log(radii[0] / radii[1]) / (isometric[1] - isometric[0]) if differ else np.sin(first)
        return float(cone), float(self.scale * SEMI_MAJOR_M * radii[0] * np.exp(cone * isometric[0]) / abs(cone))

    def _from_pole(self, latitude: Floats) -> Floats:
        """Return the lengths (N,) from the tip of the cone, negative where it opens to the south."""
        cone, factor = self._cone()
        return np.asarray(np.sign(cone) * factor * np.exp(-cone * np.arcsinh(conformal(latitude))))
