"""Units of LAS files, by well-known text of both versions and by GeoTIFF keys, and what they do to a capture."""

from __future__ import annotations

import struct
from pathlib import Path

import laspy
import numpy as np
import pytest

from capture2vr.edge.clouds.las_units import LasUnits, las_units, units_of_wkt
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.read_capture import read_capture
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
    ],
)
def test_units_of_well_known_text(text: str, units: LasUnits | None) -> None:
    assert units_of_wkt(text) == units


def written(folder: Path, records: dict[int, bytes], version: str = "1.4", *, behind: bool = False) -> Path:
    las = laspy.create(point_format=6 if version == "1.4" else 2, file_version=version)
    las.header.offsets, las.header.scales = (500_000, 4_000_000, 0), (1e-4, 1e-4, 1e-4)
    las.x, las.y, las.z = (XYZ + np.array([500_000, 4_000_000, 100])).T
    vlrs = [laspy.VLR("LASF_Projection", number, "", content) for number, content in records.items()]
    others = [laspy.VLR("somebody", 2112, "", b"no text")]
    if behind:
        las.evlrs = laspy.vlrs.vlrlist.VLRList([*others, *vlrs])
    else:
        las.header.vlrs.extend([*others, *vlrs])
    las.write(folder / "scan.las")
    return folder / "scan.las"


def keys(**values: int) -> bytes:
    numbers = {"model": 1024, "length": 3076, "height": 4099}
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


@pytest.mark.parametrize("records", [{2112: GEOGCS.encode()}, {34735: keys(model=2)}])
def test_degrees_are_refused_by_name(records: dict[int, bytes], tmp_path: Path) -> None:
    path = written(tmp_path, records, "1.4" if 2112 in records else "1.2")
    with pytest.raises(CaptureError, match="degrees of latitude and longitude") as caught:
        read_capture(path)
    assert "metres" in caught.value.hints[0]


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
        np.testing.assert_allclose(capture.up, up or np.array(place) / np.linalg.norm(place), atol=1e-3)
        np.testing.assert_allclose(capture.cloud.xyz + capture.cloud.origin, XYZ + place, atol=1e-3)
