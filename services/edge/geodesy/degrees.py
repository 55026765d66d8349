"""Project degrees of longitude and latitude to metres, on a map of their own around the middle of a survey."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.geodesy.projections import TransverseMercator

_WKT = (
    'PROJCS["Local transverse Mercator",GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],'
    'PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]],PROJECTION["Transverse_Mercator"],'
    'PARAMETER["latitude_of_origin",{latitude!r}],PARAMETER["central_meridian",{longitude!r}],'
    'PARAMETER["scale_factor",1],PARAMETER["false_easting",0],PARAMETER["false_northing",0],'
    'UNIT["metre",1],AXIS["Easting",EAST],AXIS["Northing",NORTH]]'
)
_DIGITS = 6  # of the middle in degrees: a tenth of a metre
_WIDEST = 40.0  # degrees of longitude from the middle; beyond, the series of the projection say nothing
_FARTHEST_M = 1e6  # from the middle: what is farther, such as a row of zeros, would be where the survey is moved to


@dataclass(frozen=True, slots=True)
class LocalMap:
    """A map in metres around a place in degrees (WGS 84): transverse Mercator, true to scale at its middle.

    Lengths are right within a millionth nine kilometres from it.
    """

    longitude: float
    latitude: float

    @classmethod
    def around(cls, parts: Iterable[Floats]) -> LocalMap:
        """Return the map around the median of the first part (N,3) that has any longitudes, latitudes and heights."""
        for xyz in parts:
            known = xyz[np.isfinite(xyz).all(axis=1)]
            if len(known):
                longitude, latitude, _ = np.median(known, axis=0)
                return cls(round(float(longitude), _DIGITS), float(np.clip(round(float(latitude), _DIGITS), -90, 90)))
        return cls(0.0, 0.0)

    @property
    def crs(self) -> str:
        """The map as well-known text."""
        return _WKT.format(longitude=self.longitude, latitude=self.latitude)

    def project(self, xyz: Floats) -> Floats:
        """Project longitudes and latitudes in degrees and heights in m (N,3) -> metres east and north of the middle,
        and the heights; NaN for what is no longitude and latitude near it."""
        with np.errstate(invalid="ignore"):
            away = np.mod(xyz[:, 0] - self.longitude + 180, 360) - 180
            known = (np.abs(away) <= _WIDEST) & (np.abs(xyz[:, 1]) <= 90)
        middle = TransverseMercator(0.0, np.radians(self.latitude))
        east, north = middle.forward(np.radians(np.where(known, away, 0)), np.radians(np.where(known, xyz[:, 1], 0)))
        known &= np.hypot(east, north) <= _FARTHEST_M
        return np.asarray(np.where(known[:, None], np.column_stack([east, north, xyz[:, 2]]), np.nan))
