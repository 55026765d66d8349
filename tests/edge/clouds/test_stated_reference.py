"""Units and reference systems of files, by well-known text of both versions and by GeoTIFF keys, in a capture."""

from __future__ import annotations

import struct
from pathlib import Path

import laspy
import numpy as np
import pytest
from numpy.typing import ArrayLike

from capture2vr.edge.clouds.stated_reference import LasUnits, las_units, units_of_wkt
from capture2vr.edge.points.clean_cloud import cloud_points
from capture2vr.edge.read_capture import read_capture
from capture2vr.order.reading import FileReading
from tests.edge.clouds.test_tables import RGB, XYZ

US_FOOT, FOOT = 1200 / 3937, 0.3048
GEOGCS = (
    'GEOGCS["NAD83",DATUM["NAD83",SPHEROID["GRS 1980",6378137,298.257]],PRIMEM["Greenwich",0],'
    'UNIT["degree",0.0174532925199433]]'
)
FEET = (
    f'PROJCS["Utah North",{GEOGCS},PROJECTION["Lambert"],PARAMETER["false_easting",1640416.6],'
    f'UNIT["US survey foot",{US_FOOT}]]'
)
METRES = f'PROJCS["UTM 32N",{GEOGCS},PROJECTION["TM"],UNIT["metre",1,AUTHORITY["EPSG","9001"]],AXIS["E",EAST]]'
HEIGHT = 'VERT_CS["NAVD88",VERT_DATUM["NAVD88",2005],UNIT["metre",1]]'
NEWER = (
    'PROJCRS["x",BASEGEOGCRS["y",DATUM["z",ELLIPSOID["GRS 1980",6378137,298.257,LENGTHUNIT["metre",1]]]],'
    'CONVERSION["c",METHOD["TM"],PARAMETER["a",0,ANGLEUNIT["degree",0.0174532925199433]]],'
    'CS[Cartesian,2],AXIS["easting",east],AXIS["northing",north],LENGTHUNIT["foot",0.3048]]'
)


@pytest.mark.parametrize(
    ("text", "units"),
    [
        (FEET, LasUnits(US_FOOT, US_FOOT)),
        (METRES, LasUnits(1, 1)),
        (f'COMPD_CS["both",{FEET},{HEIGHT}]', LasUnits(US_FOOT, 1)),
        (NEWER, LasUnits(FOOT, FOOT)),
        (GEOGCS, LasUnits(1, 1, degrees=True)),
        (f'COMPD_CS["both",{GEOGCS},{HEIGHT}]', LasUnits(1, 1, degrees=True)),
        ("", None),
        ('PROJCS["x",UNIT["?",nonsense]]', None),
        ('PROJCS["x",UNIT["?",1e999]]', None),
    ],
)
def test_units_of_well_known_text(text: str, units: LasUnits | None) -> None:
    assert units_of_wkt(text) == units


def written(
    folder: Path,
    records: dict[int, bytes],
    version: str = "1.4",
    *,
    behind: bool = False,
    at: ArrayLike = (500_000, 4_000_000, 100),
    scale: ArrayLike = (1, 1, 1),
) -> Path:
    las = laspy.create(point_format=6 if version == "1.4" else 2, file_version=version)
    las.header.offsets, las.header.scales = at, 1e-4 * np.asarray(scale)
    las.x, las.y, las.z = (XYZ * scale + at).T
    vlrs = [laspy.VLR("LASF_Projection", number, "", content) for number, content in records.items()]
    others = [laspy.VLR("somebody", 2112, "", b"no text")]
    if behind:
        las.evlrs = laspy.vlrs.vlrlist.VLRList([*others, *vlrs])
    else:
        las.header.vlrs.extend([*others, *vlrs])
    las.write(folder / "scan.las")
    return folder / "scan.las"


def keys(**values: int) -> bytes:
    numbers = {"model": 1024, "degrees": 2048, "map": 3072, "length": 3076, "above": 4096, "height": 4099}
    rows = [(numbers[name], 0, 1, value) for name, value in values.items()]
    return struct.pack(f"<{4 + 4 * len(rows)}H", 1, 1, 0, len(rows), *(each for row in rows for each in row))


@pytest.mark.parametrize("behind", [False, True])
def test_a_las_in_feet_is_as_large_as_it_was_measured(behind: bool, tmp_path: Path) -> None:
    text = f'COMPD_CS["both",{FEET},{HEIGHT}]\0'.encode()
    path = written(tmp_path, {2112: text}, behind=behind)
    capture = read_capture(path)
    assert capture.cloud is not None
    assert (capture.metres_per_unit, capture.scale_confidence) == (pytest.approx(US_FOOT), "metric")
    size = np.ptp(capture.cloud.xyz, axis=0) * capture.metres_per_unit
    np.testing.assert_allclose(size, np.ptp(XYZ, axis=0) * (US_FOOT, US_FOOT, 1), atol=1e-3)


def test_units_of_geotiff_keys(tmp_path: Path) -> None:
    path = written(tmp_path, {34735: keys(model=1, length=9003, height=9001)}, "1.2")
    assert las_units(path) == LasUnits(US_FOOT, 1.0)
    assert las_units(written(tmp_path, {34735: keys(model=1, length=9001)}, "1.2")) == LasUnits(1.0, 1.0)
    assert las_units(written(tmp_path, {}, "1.2")) is None


@pytest.mark.parametrize(
    ("records", "known"),
    [
        ({2112: f'COMPD_CS["both",{GEOGCS},{HEIGHT}]'.encode()}, True),
        ({34735: keys(model=2, degrees=4326)}, True),
        ({34735: keys(model=2)}, True),  # as others take them, of WGS 84
        ({2112: GEOGCS.replace("6378137,298.257", "6377397,299.153").encode()}, False),
    ],
)
def test_degrees_are_projected_and_said(records: dict[int, bytes], known: bool, tmp_path: Path) -> None:
    path = written(tmp_path, records, "1.4" if 2112 in records else "1.2", at=(8, 47, 400), scale=(1e-5, 1e-5, 1))
    capture = read_capture(path)
    assert capture.cloud is not None
    assert (capture.metres_per_unit, capture.scale_confidence) == (1, "metric")
    assert any("degrees of longitude and latitude" in warning for warning in capture.warnings)
    size = np.ptp(XYZ, axis=0) * (0.760559, 1.111742, 1)  # of a hundred thousandth of a degree at 47° N
    np.testing.assert_allclose(np.ptp(capture.cloud.xyz, axis=0), size, atol=0.02)
    assert capture.cloud.crs.startswith('PROJCS["Local') == known
    told = read_capture(path, reading=FileReading(unit="deg"))
    assert told.cloud is not None
    np.testing.assert_array_equal(told.cloud.xyz, capture.cloud.xyz)
    assert not any("degrees" in warning for warning in told.warnings)


@pytest.mark.parametrize(("at", "scale"), [((0, 0, 0), (20, 20, 1)), ((600, 47, 0), (0.01, 0.01, 1))])
def test_degrees_that_are_none_are_lengths(
    at: tuple[float, float, float], scale: tuple[float, float, float], tmp_path: Path
) -> None:
    """Some programs write WGS 84 into every file."""
    capture = read_capture(written(tmp_path, {34735: keys(model=2, degrees=4326)}, "1.2", at=at, scale=scale))
    assert capture.cloud is not None
    np.testing.assert_allclose(np.ptp(capture.cloud.xyz, axis=0), np.ptp(XYZ * scale, axis=0), atol=0.01)
    assert (capture.cloud.crs, capture.scale_confidence) == ("", "estimated")
    assert any("they were taken for lengths" in warning for warning in capture.warnings)


@pytest.mark.parametrize(
    ("records", "reading", "crs"),
    [
        ({2112: METRES.encode() + b"\0"}, FileReading(), METRES),
        ({2112: METRES.replace(",", ",\n ").encode()}, FileReading(), METRES.replace(",", ", ")),
        ({2112: METRES.encode()}, FileReading(unit="m"), METRES),
        ({2112: METRES.encode()}, FileReading(unit="ft"), ""),
        ({2112: METRES.replace("UTM", "\x1b[2J").encode()}, FileReading(), ""),
        ({2112: METRES.replace("UTM", "x" * 10_000).encode()}, FileReading(), ""),
        ({34735: keys(model=1, map=32632, above=5773)}, FileReading(), "EPSG:32632+5773"),
        ({34735: keys(model=1, map=32632, length=9003)}, FileReading(), ""),  # which is it?
        ({34735: keys(model=1, map=32767, length=9001)}, FileReading(), ""),
        ({34735: keys(model=1, degrees=4326, length=9001)}, FileReading(), ""),
        ({34735: keys(model=3, degrees=4978)}, FileReading(), "EPSG:4978"),
        ({}, FileReading(), ""),
    ],
)
def test_the_system_goes_with_the_capture(
    records: dict[int, bytes], reading: FileReading, crs: str, tmp_path: Path
) -> None:
    capture = read_capture(written(tmp_path, records, "1.4" if 2112 in records else "1.2"), reading=reading)
    assert capture.cloud is not None
    assert capture.cloud.crs == cloud_points(capture).crs == crs


def test_a_code_of_a_map_in_metres_tells_the_unit_too(tmp_path: Path) -> None:
    assert las_units(written(tmp_path, {34735: keys(model=1, map=25832)}, "1.2")) == LasUnits(1.0, 1.0)


def test_a_prj_beside_a_table_tells_its_system(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "Scan.xyz", np.column_stack([XYZ + np.array([345_678, 5_432_100, 321]), RGB]), fmt="%.4f")
    (tmp_path / "scan.PRJ").write_text(FEET)
    capture = read_capture(tmp_path)
    assert capture.cloud is not None
    assert (capture.cloud.crs, capture.metres_per_unit, capture.scale_confidence) == (FEET, US_FOOT, "metric")
    (tmp_path / "scan.PRJ").write_text("no system at all")
    assert read_capture(tmp_path).scale_confidence == "unknown"


def test_geocentric_scans_have_the_earths_up_in_every_format(tmp_path: Path) -> None:
    place = np.array([4_075_000, 931_000, 4_801_000])
    path = written(tmp_path, {34735: keys(model=3, degrees=4978)}, "1.2", at=place)
    up = read_capture(path).up
    assert up is not None
    np.testing.assert_allclose(up, place / np.linalg.norm(place), atol=4e-3)


def test_a_damaged_header_names_no_unit(tmp_path: Path) -> None:
    whole = written(tmp_path, {2112: FEET.encode()}).read_bytes()
    rng = np.random.default_rng(0)
    for _ in range(200):
        damaged = bytearray(whole[:2_000])
        for place in rng.integers(90, 900, 6):
            damaged[place] = rng.integers(256)
        (tmp_path / "damaged.las").write_bytes(damaged)
        las_units(tmp_path / "damaged.las")


def test_survey_coordinates_have_z_up_and_geocentric_ones_the_earths(tmp_path: Path) -> None:
    for place, up in (((345_678, 5_432_100, 321), (0, 0, 1)), ((4_075_000, 931_000, 4_801_000), None)):
        lines = np.column_stack([np.tile(XYZ, (1, 1)) + place, RGB])
        np.savetxt(tmp_path / "a.xyz", lines, fmt="%.4f %.4f %.4f %d %d %d")
        capture = read_capture(tmp_path / "a.xyz")
        assert capture.cloud is not None
        assert capture.up is not None
        np.testing.assert_allclose(capture.up, up or np.array(place) / np.linalg.norm(place), atol=4e-3)
        np.testing.assert_allclose(capture.cloud.xyz + capture.cloud.origin, XYZ + place, atol=1e-3)
