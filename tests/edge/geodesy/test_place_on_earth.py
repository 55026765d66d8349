"""Where an asset stands on earth, by geocentric places that PROJ 9.5 has computed, and by what a frame must be."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.edge.arrays import Floats
from capture2vr.edge.geodesy.ellipsoid import to_ecef
from capture2vr.edge.geodesy.epsg_codes import projection_of
from capture2vr.edge.geodesy.place_on_earth import asset_to_earth, survey_up
from tests.edge.geodesy.test_reference_system import UTAH

OFFSET = np.array([691_607.0, 5_334_760.0, 520.0])
# Of UTM 32N and heights over WGS 84 -> EPSG:4978: the place (691,607.9 5,334,760.4 520), and 100 m east, north, up.
PLACES = np.array([[0.9, 0.4, 0], [100.9, 0.4, 0], [0.9, 100.4, 0], [0.9, 0.4, 100]])
GEOCENTRIC = np.array(
    [
        [4177973.4909, 855757.4489, 4727459.5724],
        [4177955.8779, 855855.8633, 4727457.3373],
        [4177899.8974, 855745.7928, 4727526.2713],
        [4178038.8684, 855770.8399, 4727534.0469],
    ]
)


def on_earth(to_earth: Floats, to_asset: Floats, capture: Floats) -> Floats:
    """Place points (N,3) of a capture by way of the asset."""
    asset = capture @ to_asset[:3, :3].T + to_asset[:3, 3]
    return np.asarray(asset @ to_earth[:3, :3].T + to_earth[:3, 3])


def frame(seed: int, scale: float = 1.0) -> Floats:
    """Some (4,4) from a capture to an asset: turned, scaled and moved."""
    rng = np.random.default_rng(seed)
    matrix = np.eye(4)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    matrix[:3, :3] = scale * turn * np.sign(np.linalg.det(turn))
    matrix[:3, 3] = rng.normal(0, 30, 3)
    return matrix


@pytest.mark.parametrize(("crs", "seed"), [("EPSG:32632", 0), ("EPSG:25832+7837", 1)])
def test_tiles_of_a_map_stand_where_they_were_measured(crs: str, seed: int) -> None:
    to_asset = frame(seed)
    to_earth = asset_to_earth(crs, OFFSET, to_asset)
    assert to_earth is not None
    # 100 m away the earth is 0.8 mm lower.
    np.testing.assert_allclose(on_earth(to_earth, to_asset, PLACES), GEOCENTRIC, atol=2e-3)


def test_geocentric_coordinates_stand_where_they_are() -> None:
    to_asset = frame(2)
    to_earth = asset_to_earth("EPSG:4978", GEOCENTRIC[0], to_asset)
    assert to_earth is not None
    np.testing.assert_allclose(on_earth(to_earth, to_asset, GEOCENTRIC - GEOCENTRIC[0]), GEOCENTRIC, atol=1e-6)


def test_coordinates_in_feet_stand_where_they_were_measured() -> None:
    """At the place that the test of its projection has; the asset is in metres."""
    to_asset = frame(3, scale=1200 / 3937)
    to_earth = asset_to_earth(UTAH, np.array([1_533_977.0, 3_793_587.0, 4_500.0]), to_asset)
    assert to_earth is not None
    truth = to_ecef(np.radians([-111.89]), np.radians([41.74]), np.array([4_501 * 1200 / 3937]))
    np.testing.assert_allclose(on_earth(to_earth, to_asset, np.array([[0.6811, 0.8201, 1]])), truth, atol=1e-3)
    assert np.abs(np.linalg.det(to_earth[:3, :3]) - 1) < 1e-3, "in metres on both sides"


@given(st.floats(0.1, 5.9), st.floats(-80, 80), st.floats(-100, 4_000))
def test_north_of_a_map_is_turned_by_its_convergence(longitude: float, latitude: float, height: float) -> None:
    """Of the east axis, against the true one: near atan(tan λ sin φ), to which an ellipsoid adds some seconds."""
    projection = projection_of(32631 if latitude > 0 else 32731)
    assert projection is not None
    where = np.radians([longitude]), np.radians([latitude])
    east, north = (float(value[0]) for value in projection.forward(*where))
    to_earth = asset_to_earth(
        "EPSG:32631" if latitude > 0 else "EPSG:32731", np.array([east, north, height]), np.eye(4)
    )
    assert to_earth is not None
    np.testing.assert_allclose(to_earth[:3, 3], to_ecef(*where, np.array([height]))[0], atol=1e-3)
    (lon,), (lat,) = where
    true_east = np.array([-np.sin(lon), np.cos(lon), 0])
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    true_north = np.cross(up, true_east)
    turned = np.arctan2(-to_earth[:3, 0] @ true_north, to_earth[:3, 0] @ true_east)
    assert -turned == pytest.approx(-np.arctan(np.tan(lon - np.radians(3)) * np.sin(lat)), abs=2e-5)
    np.testing.assert_allclose(to_earth[:3, 2], up, atol=1e-9)
    assert np.linalg.det(to_earth[:3, :3]) == pytest.approx(1, abs=3e-3), "right-handed, in metres"


@pytest.mark.parametrize(
    ("crs", "offset"),
    [
        ("", OFFSET),
        ("EPSG:4326", OFFSET),
        ("EPSG:27700", OFFSET),
        ("EPSG:4978", np.zeros(3)),  # the middle of the earth
        ("EPSG:32632", np.array([5e8, 5e8, 0])),
        ("EPSG:32632", np.array([5e5, 5e6, 1e6])),
        ("EPSG:2154", np.array([np.inf, 5e6, 0])),
    ],
)
def test_what_is_nowhere_on_earth_has_no_place(crs: str, offset: Floats) -> None:
    assert asset_to_earth(crs, offset, np.eye(4)) is None


def test_up_of_a_survey() -> None:
    assert survey_up(None, "") is None
    for origin, crs in ((None, "EPSG:32632"), (OFFSET, ""), (np.array([500_000, 6_350_000, 30]), "")):
        np.testing.assert_array_equal(survey_up(origin, crs), [0, 0, 1])
    lon, lat = np.radians([[11.5], [48.1]])
    up = survey_up(to_ecef(lon, lat, np.array([2_000.0]))[0], "EPSG:4978")
    truth = np.concatenate([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    np.testing.assert_allclose(up, truth, atol=1e-5)
