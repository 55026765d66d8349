"""Where a survey stands on earth: from its file's coordinates, or an asset's frame, to geocentric ones (EPSG:4978)."""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.geodesy.ellipsoid import FLATTENING, to_ecef
from capture2vr.edge.geodesy.projections import Projection
from capture2vr.edge.geodesy.reference_system import ReferenceSystem, reference_of

_STEP_M = 50.0  # on the map, by which the axes are measured: their error is under a millionth of a degree
_NEAR_EARTH_M = 6.2e6, 6.6e6  # from its middle: no survey is deeper or higher, and coordinates that are none are
_MOST_STRETCH = 0.2  # of a map's lengths: whoever uses one has them nearly true
_SURFACE_M = 6.33e6, 6.40e6  # from the middle of the earth to its surface
_HIGHEST_M = 10_000.0  # a height above this is none


def asset_to_earth(crs: str, offset: Floats | None, to_asset: Floats) -> Floats | None:
    """Compute the transform (4,4) from an asset's frame to geocentric coordinates, both in metres.

    crs, offset  of the capture's file, (3,) what was subtracted from its coordinates; to_asset (4,4): from the capture

    None where the reference system is not understood, or the place is not on earth. Heights are taken for ellipsoidal.
    It is exact at the asset's origin; away from it the earth curves, by 8 cm in a kilometre, and a map does not.
    """
    reference = reference_of(crs)
    if reference is None:
        return None
    from_asset = np.linalg.inv(to_asset)
    from_asset[:3, 3] += 0 if offset is None else offset
    to_earth = _axes_at(reference, from_asset[:3, 3])
    if to_earth is None:
        return None
    placed = np.eye(4)
    placed[:3, :3] = to_earth[:, :3] @ from_asset[:3, :3]
    placed[:3, 3] = to_earth[:, 3]
    return placed


def survey_up(origin: Floats | None, crs: str) -> Floats | None:
    """Return which way is up (3,) where coordinates are those of a survey, moved by `origin`; None where they are not.

    In geocentric coordinates (ECEF) up is away from the ellipsoid of the earth, in those of a map it is Z.
    """
    if origin is None:
        return np.array([0.0, 0, 1]) if crs else None
    away = float(np.linalg.norm(origin))
    if not (_SURFACE_M[0] < away < _SURFACE_M[1] and abs(origin[2]) > _HIGHEST_M):
        return np.array([0.0, 0, 1])
    normal = origin / (1, 1, (1 - FLATTENING) ** 2)
    return np.asarray(normal / np.linalg.norm(normal))


def _axes_at(reference: ReferenceSystem, place: Floats) -> Floats | None:
    """Return (3,4) geocentric: what one unit along each axis of a file is at a place (3,) of its coordinates, and the
    place itself; None where that is not on earth."""
    if reference.kind == "degrees":
        return None
    if reference.projection is None:
        axes: Floats = np.column_stack([np.eye(3), place]) * reference.metres
    else:
        with np.errstate(all="ignore"):
            axes = _axes_of_map(reference.projection, place * reference.metres)
        axes[:, :3] *= reference.metres
    away = float(np.linalg.norm(axes[:, 3]))
    is_there = np.isfinite(axes).all() and _NEAR_EARTH_M[0] < away < _NEAR_EARTH_M[1]
    lengths = np.linalg.norm(axes[:, :3], axis=0) / reference.metres
    return axes if is_there and (np.abs(lengths - 1) < _MOST_STRETCH).all() else None


def _axes_of_map(projection: Projection, place_m: Floats) -> Floats:
    """The same of a map in metres. Its convergence and its scale are in the axes, which are measured on the earth."""
    steps = _STEP_M * np.array([[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    east, north, _ = (place_m + steps).T
    longitude, latitude = projection.inverse(east, north)
    origin, right, left, ahead, behind = to_ecef(longitude, latitude, np.full(5, place_m[2]))
    up = np.array([np.cos(latitude[0]) * np.cos(longitude[0]), np.cos(latitude[0]) * np.sin(longitude[0]), 0])
    up[2] = np.sin(latitude[0])
    return np.column_stack([(right - left) / (2 * _STEP_M), (ahead - behind) / (2 * _STEP_M), up, origin])
