"""Degrees of longitude and latitude on a map of their own: lengths, what is no degree, and its text."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.edge.clouds.array_cloud import capture_of_points
from capture2vr.edge.geodesy.degrees import LocalMap
from capture2vr.edge.geodesy.ellipsoid import to_ecef
from capture2vr.edge.geodesy.place_on_earth import asset_to_earth
from tests.edge.geodesy.test_place_on_earth import on_earth


@given(st.floats(-180, 180), st.floats(-85, 85), st.integers(0, 9))
def test_distances_are_those_on_the_earth(longitude: float, latitude: float, seed: int) -> None:
    """Of points within a kilometre, as straight lines through it; also over the line where the date changes."""
    rng = np.random.default_rng(seed)
    metres = rng.uniform(-1_000, 1_000, (20, 2))
    degrees = metres / (111_320 * np.cos(np.radians(latitude)), 111_320)
    lon, lat = longitude + degrees[:, 0], latitude + degrees[:, 1]
    xyz = np.column_stack([np.where(lon > 180, lon - 360, lon), lat, np.zeros(20)])
    found = LocalMap(longitude, round(latitude, 6)).project(xyz)
    truth = to_ecef(np.radians(lon), np.radians(lat), np.zeros(20))
    for one, other in ((0, slice(1, 10)), (11, slice(12, None))):
        lengths = [np.linalg.norm(each[one] - each[other], axis=1) for each in (found, truth)]
        np.testing.assert_allclose(*lengths, rtol=1e-6)


def test_degrees_around_the_earth_have_its_lengths() -> None:
    """A degree of latitude is 110.57 km at the equator and 111.69 at the poles; one of longitude 55.80 at 60° N."""
    for latitude, along, across in ((0.0, 110_574, 111_320), (60.0, 111_412, 55_800), (88.9, 111_694, 2_145)):
        metres = LocalMap(7.0, latitude).project(np.array([[8, latitude, 5], [7, latitude + 1, 5]]))
        np.testing.assert_allclose(metres[[0, 1], [0, 1]], [across, along], rtol=2e-3)


@given(st.floats(-180, 180), st.floats(-85, 85))
def test_its_text_places_it_where_the_degrees_are(longitude: float, latitude: float) -> None:
    around = LocalMap.around([np.array([[longitude, latitude, 100.0]])])
    xyz = np.array([[longitude, latitude, 100.0], [longitude, latitude, 102.0]])
    to_earth = asset_to_earth(around.crs, None, np.eye(4))
    assert to_earth is not None
    truth = to_ecef(np.radians(xyz[:, 0]), np.radians(xyz[:, 1]), xyz[:, 2])
    np.testing.assert_allclose(on_earth(to_earth, np.eye(4), around.project(xyz)), truth, atol=1e-3)


def test_what_is_no_degree_is_no_number() -> None:
    around = LocalMap.around([np.full((2, 3), np.nan), np.array([[7.0, 47, 400]] * 5)])
    assert (around.longitude, around.latitude) == (7, 47)
    rows = np.array(
        [[7, 47, 400], [7, 91, 400], [np.nan, 47, 400], [np.inf, 47, 400], [120, 47, 400], [0, 0, 0]], np.float64
    )
    found = around.project(rows)
    assert found[0] == pytest.approx([0, 0, 400], abs=1e-6)
    assert np.isnan(found[1:]).all()


def test_a_scan_without_points_has_a_map_all_the_same() -> None:
    assert LocalMap.around([]) == LocalMap(0, 0)


def test_an_array_in_degrees_is_projected() -> None:
    xyz = np.random.default_rng(0).uniform(-1, 1, (500, 3))
    capture = capture_of_points(xyz / (76_055.9, 111_174.2, 1) + (8, 47, 400), unit="deg")
    assert capture.cloud is not None
    np.testing.assert_allclose(capture.cloud.xyz - capture.cloud.xyz[0], xyz - xyz[0], atol=1e-4)
