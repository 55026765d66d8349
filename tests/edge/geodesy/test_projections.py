"""Map projections: there and back in any zone, and places that PROJ 9.5 has projected."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.edge.geodesy.epsg_codes import projection_of, utm
from capture2vr.edge.geodesy.projections import LambertConic, Projection

EARTH_M = 6.37e6
DEGREES = st.floats(-80, 80)


def apart_m(projection: Projection, longitude: float, latitude: float) -> float:
    """How far from itself a place in degrees is, once it was projected and back."""
    place = np.radians([longitude]), np.radians([latitude])
    there = projection.inverse(*projection.forward(*place))
    turned = np.mod(there[0] - place[0] + np.pi, 2 * np.pi) - np.pi
    return EARTH_M * float(np.hypot(turned * np.cos(place[1]), there[1] - place[1])[0])


@given(st.integers(1, 60), st.sampled_from([0.0, 1e7]), st.floats(-9, 9), st.floats(-84, 84))
def test_every_zone_of_utm_goes_there_and_back(zone: int, north_m: float, away: float, latitude: float) -> None:
    assert apart_m(utm(zone, north_m), 6 * zone - 183 + away, latitude) < 1e-3


@given(DEGREES, DEGREES, st.floats(0.5, 20), st.floats(-100, 100), DEGREES)
def test_every_cone_goes_there_and_back(at: float, first: float, apart: float, away: float, latitude: float) -> None:
    parallels = (first, first + apart) if first > 0 else (first, first - apart)
    if abs(first) > 5 and max(map(abs, parallels)) < 85:
        conic = LambertConic(np.radians(at), np.radians(first), tuple(np.radians(parallels)))
        assert apart_m(conic, at + away, latitude) < 1e-3


@pytest.mark.parametrize(
    ("code", "longitude", "latitude", "east", "north"),
    [
        (32632, 11.5755, 48.1374, 691603.032, 5334780.0309),
        (25832, 6.0, 50.9, 289058.6773, 5642992.0348),
        (4647, 6.0, 50.9, 32289058.6773, 5642992.0348),
        (32760, 178.5, -38.2, 631341.0882, 5770930.8499),
        (2154, 2.2945, 48.8582, 648237.1029, 6862249.4434),
        (2193, 174.7762, -41.2866, 1748735.3259, 5427905.3767),
        (3763, -9.1393, 38.7223, -87503.4389, -104538.8924),
        (3301, 24.7536, 59.437, 542763.3691, 6589036.2754),
        (2180, 21.0122, 52.2297, 637382.2044, 486757.2095),
        (3006, 18.0686, 59.3293, 674571.8664, 6580743.0083),
        (5110, 10.75, 59.91, 113987.8508, 1212789.5148),
    ],
)
def test_a_code_projects_as_others_do(code: int, longitude: float, latitude: float, east: float, north: float) -> None:
    projection = projection_of(code)
    assert projection is not None
    found = np.concatenate(projection.forward(np.radians([longitude]), np.radians([latitude])))
    np.testing.assert_allclose(found, [east, north], atol=2e-4)


def test_a_quarter_of_a_meridian_is_as_long_as_the_ellipsoid_says() -> None:
    """From the equator to a pole along the middle of a zone: 10,001,965.729 m, times its scale."""
    _, north = utm(31).forward(np.radians([3.0, 3.0]), np.radians([90.0, -90.0]))
    np.testing.assert_allclose(north, [0.9996 * 10_001_965.7293, -0.9996 * 10_001_965.7293], atol=1e-3)


@pytest.mark.parametrize("code", [27700, 31467, 2056, 3857, 4326, 99_999])
def test_codes_of_other_systems_are_not_known(code: int) -> None:
    assert projection_of(code) is None
