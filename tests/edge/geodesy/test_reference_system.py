"""Coordinate reference systems by code and by well-known text of three dialects, and hostile ones."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture2vr.edge.geodesy.epsg_codes import projection_of
from capture2vr.edge.geodesy.reference_system import ReferenceSystem, reference_of
from capture2vr.edge.geodesy.well_known_text import MOST_CHARACTERS, parse_wkt, tidy

DEGREE = 'UNIT["degree",0.0174532925199433]'
GEOGCS = (
    'GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],PRIMEM["Greenwich",0],' + DEGREE + "]"
)
UTM_32 = (
    f'PROJCS["WGS 84 / UTM zone 32N",{GEOGCS},PROJECTION["Transverse_Mercator"],PARAMETER["latitude_of_origin",0],'
    'PARAMETER["central_meridian",9],PARAMETER["scale_factor",0.9996],PARAMETER["false_easting",500000],'
    'PARAMETER["false_northing",0],UNIT["metre",1,AUTHORITY["EPSG","9001"]],AXIS["Easting",EAST]]'
)
ETRS_32 = (
    'PROJCRS["ETRS89 / UTM zone 32N",BASEGEOGCRS["ETRS89",ENSEMBLE["European Terrestrial Reference System 1989",'
    'MEMBER["European Terrestrial Reference Frame 1989"],ELLIPSOID["GRS 1980",6378137,298.257222101,'
    'LENGTHUNIT["metre",1]]],PRIMEM["Greenwich",0,ANGLEUNIT["degree",0.0174532925199433]]],'
    'CONVERSION["UTM zone 32N",METHOD["Transverse Mercator",ID["EPSG",9807]],'
    'PARAMETER["Latitude of natural origin",0,ANGLEUNIT["degree",0.0174532925199433]],'
    'PARAMETER["Longitude of natural origin",9,ANGLEUNIT["degree",0.0174532925199433]],'
    'PARAMETER["Scale factor at natural origin",0.9996,SCALEUNIT["unity",1]],'
    'PARAMETER["False easting",500000,LENGTHUNIT["metre",1]],PARAMETER["False northing",0,LENGTHUNIT["metre",1]]],'
    'CS[Cartesian,2],AXIS["(E)",east,ORDER[1],LENGTHUNIT["metre",1]],AXIS["(N)",north,ORDER[2],LENGTHUNIT["metre",1]]]'
)
UTAH = (
    'PROJCS["NAD_1983_StatePlane_Utah_North_FIPS_4301_Feet",GEOGCS["GCS_North_American_1983",'
    'DATUM["D_North_American_1983",SPHEROID["GRS_1980",6378137.0,298.257222101]],PRIMEM["Greenwich",0.0],'
    'UNIT["Degree",0.0174532925199433]],PROJECTION["Lambert_Conformal_Conic"],PARAMETER["False_Easting",1640416.6667],'
    'PARAMETER["False_Northing",3280833.3333],PARAMETER["Central_Meridian",-111.5],'
    'PARAMETER["Standard_Parallel_1",41.7833333333333],PARAMETER["Standard_Parallel_2",40.7166666666667],'
    'PARAMETER["Latitude_Of_Origin",40.3333333333333],UNIT["US survey foot",0.304800609601219]]'
)
HEIGHT = 'VERT_CS["EGM96 height",VERT_DATUM["EGM96 geoid",2005],UNIT["metre",1]]'
GEOCENTRIC = GEOGCS.replace("GEOGCS", "GEOCCS").replace(DEGREE, 'UNIT["metre",1],AXIS["Geocentric X",OTHER]')
UTM = ReferenceSystem("map", projection=projection_of(32632))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("EPSG:32632", UTM),
        ("EPSG:25832+7837", UTM),
        (UTM_32, UTM),
        (f'COMPD_CS["both",{UTM_32},{HEIGHT}]', UTM),
        (ETRS_32, UTM),
        (UTM_32.replace("[", "(").replace("]", ")").replace(",", " ,\n  "), UTM),
        ("EPSG:4978", ReferenceSystem("geocentric")),
        (GEOCENTRIC, ReferenceSystem("geocentric")),
        ("EPSG:4326", ReferenceSystem("degrees")),
        (f'COMPD_CS["both",{GEOGCS},{HEIGHT}]', ReferenceSystem("degrees")),
    ],
)
def test_systems_that_are_known(text: str, expected: ReferenceSystem) -> None:
    found = reference_of(text)
    assert found is not None
    assert (found.kind, found.metres) == (expected.kind, expected.metres)
    assert (found.projection is None) == (expected.projection is None)
    if found.projection is not None and expected.projection is not None:
        place = np.radians([11.0, 7.0]), np.radians([48.0, -33.0])
        np.testing.assert_allclose(found.projection.forward(*place), expected.projection.forward(*place), atol=1e-6)


def test_a_cone_in_feet_projects_as_proj_does() -> None:
    found = reference_of(UTAH)
    assert found is not None
    assert found.projection is not None
    place = np.concatenate(found.projection.forward(np.radians([-111.89]), np.radians([41.74])))
    np.testing.assert_allclose(place / found.metres, [1533977.6811, 3793587.8201], atol=1e-3)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "EPSG:27700",
        "EPSG:32632 and more",
        UTM_32.replace("6378137,298.257223563", "6377397.155,299.1528128"),  # Bessel's ellipsoid
        UTM_32.replace("Transverse_Mercator", "Polyconic"),
        UTM_32.replace("Greenwich", "Paris").replace('Paris",0', 'Paris",2.337229'),
        UTM_32.replace("WGS_1984", "GGRS87"),
        UTM_32.replace("563]]", "563],TOWGS84[-199.87,74.79,246.62,0,0,0,0]]"),
        UTM_32.replace('"central_meridian",9', '"central_meridian",nan'),
        UTM_32.replace('"central_meridian",9', '"central_meridian",1e300'),
        UTM_32.replace('UNIT["metre",1,', 'UNIT["metre",-1,'),
        UTAH.replace("41.78", "-40.71").replace("40.7166666666667", "40.71333333333"),
        UTM_32[:-1],
        UTM_32 + "]",
        "PROJCS[" * 200,
        f'PROJCS["{"x" * MOST_CHARACTERS}"]',
    ],
)
def test_other_systems_have_no_place(text: str) -> None:
    assert reference_of(text) is None


@settings(max_examples=40)
@given(st.text('PROJCSGEO"[](),1 .-', max_size=80))
def test_any_text_is_parsed_or_refused(text: str) -> None:
    reference_of(text)
    tree = parse_wkt(f'{text},A["b",1]')
    assert tree is None or tree.keyword == tree.keyword.upper()


def test_a_text_is_kept_in_one_line_if_it_can_be_printed() -> None:
    assert tidy('PROJCS["a",\r\n  UNIT["m",1]]\n\0rubbish') == 'PROJCS["a", UNIT["m",1]]'
    assert tidy("EPSG:25832+7837\0") == "EPSG:25832+7837"
    assert tidy('LOCAL_CS["\x1b[2J"]') == tidy(f'LOCAL_CS["{MOST_CHARACTERS * "x"}"]') == ""


def test_of_a_text_nothing_is_kept_but_a_system() -> None:
    """It is published: what somebody wrote into the field, or behind a system, is not."""
    remarked = ETRS_32.removesuffix("]") + ',REMARK["Ann\'s ""old"" house"]]'
    assert tidy(remarked) == ETRS_32
    others = f"Ann {UTM_32}", f"{UTM_32} Ann", f"{UTM_32}Ann]", f"{UTM_32},Ann,{UTM_32}", remarked[:-1]
    for text in ("the garden of Ann", 'NOTE["Ann"]', *others):
        assert tidy(text) == ""
