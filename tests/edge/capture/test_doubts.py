"""What is doubted of a capture, how a person answers, and that an answer is what is read."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.read_capture import read_capture
from capture2vr.order.questions import flags_of, questions_of
from capture2vr.order.reading import METRES, FileReading, UnitName
from capture2vr.sentences.sentence import Sentence

BALL = np.random.default_rng(0).normal(size=(600, 3))
BALL /= np.linalg.norm(BALL, axis=1, keepdims=True)


def written(folder: Path, rows: np.ndarray, name: str = "scan.xyz") -> Path:
    np.savetxt(folder / name, rows, fmt="%.9g")
    return folder / name


def codes(capture: Capture) -> set[str]:
    return {warning.code for warning in capture.warnings if isinstance(warning, Sentence)}


def coordinates(capture: Capture) -> np.ndarray:
    assert capture.cloud is not None
    return capture.cloud.xyz


def in_degrees(metres: np.ndarray) -> np.ndarray:
    """Longitude, latitude and height of places around 11° E, 48° N, by the ellipsoid's radii there."""
    e2, sine = 0.00669437999, np.sin(np.radians(48))
    across = 6378137 / np.sqrt(1 - e2 * sine**2)
    along = across * (1 - e2) / (1 - e2 * sine**2)
    return np.stack(
        [
            11 + np.degrees(metres[:, 0] / (across * np.cos(np.radians(48)))),
            48 + np.degrees(metres[:, 1] / along),
            520 + metres[:, 2],
        ],
        axis=1,
    )


@pytest.mark.parametrize(
    ("name", "rows", "doubt"),
    [
        ("scan.xyz", BALL, None),
        ("scan_ft.xyz", BALL, "doubt_feet"),
        ("left.xyz", BALL, None),  # no feet
        ("scan.xyz", in_degrees(30 * BALL), "doubt_degrees"),
        ("scan.xyz", np.c_[BALL[:, :2], 1000 * BALL[:, 2]], "doubt_one_side_long"),
        ("scan.xyz", np.c_[np.linspace(0, 3, 600), BALL[:, :2]], "doubt_column_counts"),
        ("scan.xyz", np.c_[BALL, np.full((600, 3), 3)], "doubt_colours_black"),
        ("scan.xyz", np.c_[BALL, np.full((600, 3), 255)], "doubt_colours_white"),
        ("wall.xyz", BALL * [4, 3, 0.001], None),  # flat, not long
        ("grid.xyz", np.stack(np.meshgrid(*[np.arange(25) / 10] * 2, [0, 1]), -1).reshape(-1, 3), None),
    ],
)
def test_what_is_hardly_meant_is_doubted(name: str, rows: np.ndarray, doubt: str | None, tmp_path: Path) -> None:
    found = codes(read_capture(written(tmp_path, rows, name)))
    assert {code for code in found if code.startswith("doubt_")} == ({doubt} if doubt else set())


@pytest.mark.parametrize("unit", [unit for unit in METRES if unit != "deg"])
def test_a_unit_that_is_told_is_the_files(unit: str, tmp_path: Path) -> None:
    capture = read_capture(written(tmp_path, BALL, "scan_ft.xyz"), reading=FileReading(unit=unit))  # type: ignore[arg-type]
    assert capture.metres_per_unit == METRES[unit]  # type: ignore[index]
    assert capture.scale_confidence == "metric"
    assert "doubt_feet" not in codes(capture)


def test_a_unit_changes_no_photos(tmp_path: Path) -> None:
    for number in range(3):
        Image.fromarray(np.full((64, 96, 3), 40 * number, np.uint8)).save(tmp_path / f"{number}.png")
    plain, told = read_capture(tmp_path), read_capture(tmp_path, reading=FileReading(unit="mm"))
    assert (told.metres_per_unit, told.scale_confidence) == (plain.metres_per_unit, plain.scale_confidence)
    assert codes(told) - codes(plain) == {"unit_of_points_alone"}


@pytest.mark.parametrize("reading", [FileReading(), FileReading(unit="deg")])
def test_degrees_become_metres(reading: FileReading, tmp_path: Path) -> None:
    capture = read_capture(written(tmp_path, in_degrees(30 * BALL)), reading=reading)
    assert capture.scale_confidence == "metric"
    truth = 30 * BALL
    read = coordinates(capture)
    np.testing.assert_allclose(read - read.mean(axis=0), truth - truth.mean(axis=0), atol=0.05)


def test_latitude_may_come_first(tmp_path: Path) -> None:
    path = written(tmp_path, in_degrees(30 * BALL)[:, [1, 0, 2]])
    capture = read_capture(path, reading=FileReading(columns="x=2,y=1,z=3", unit="deg"))
    np.testing.assert_allclose(np.ptp(coordinates(capture), axis=0), np.ptp(30 * BALL, axis=0), atol=0.05)


@pytest.mark.parametrize(
    ("names", "metres", "columns"),
    [
        ("lon,lat,height", 1, ""),
        ("Longitude [deg],Latitude [deg],Alt [ft]", 0.3048, ""),
        ("longitude_deg,latitude_deg,height_m", 1, ""),
        ("# lng,lat,z", 1, ""),
        ("lon,lat,height", 1, "x=1,y=2,z=3"),
    ],
)
@pytest.mark.parametrize("unit", ["", "deg"])
def test_columns_named_longitude_and_latitude_are_projected(
    names: str, metres: float, columns: str, unit: UnitName, tmp_path: Path
) -> None:
    """Also of a wide survey, whose numbers alone do not look like degrees."""
    truth = 3000 * BALL
    path = tmp_path / "scan.csv"
    np.savetxt(path, in_degrees(truth) / (1, 1, metres), fmt="%.9f", delimiter=",", header=names, comments="")
    capture = read_capture(path, reading=FileReading(columns, unit))
    assert (capture.metres_per_unit, capture.scale_confidence) == (1, "metric")
    read = coordinates(capture)
    np.testing.assert_allclose(read - read.mean(axis=0), truth - truth.mean(axis=0), atol=10)
    assert capture.cloud is not None
    assert capture.cloud.crs.startswith("PROJCS")
    assert ("degrees_were_projected" in codes(capture)) == (unit == "")
    assert questions_of(capture.warnings) == []


def test_columns_beside_longitude_and_latitude_that_are_told_are_no_degrees(tmp_path: Path) -> None:
    path = tmp_path / "scan.csv"
    rows = np.c_[in_degrees(BALL)[:, :2], BALL]
    np.savetxt(path, rows, fmt="%.6f", delimiter=",", header="lat,lon,u,v,h [ft]", comments="")
    capture = read_capture(path, reading=FileReading("x=3,y=4,z=5"))
    assert capture.scale_confidence == "unknown"
    np.testing.assert_allclose(coordinates(capture), BALL, atol=1e-5)


def test_columns_that_are_told_are_read(tmp_path: Path) -> None:
    rows = np.c_[np.arange(600) ** 1.5, BALL[:, 2], BALL[:, :2], np.full((600, 3), [10, 120, 250])]
    reading = FileReading("z=2,x=3,y=4,r=7,g=6,b=5")
    capture = read_capture(written(tmp_path, rows), reading=reading)
    assert questions_of(capture.warnings) == [], "what was answered is not asked again"
    np.testing.assert_allclose(coordinates(capture), BALL, atol=1e-6)
    assert capture.cloud is not None
    assert capture.cloud.rgb is not None
    assert capture.cloud.rgb[0].tolist() == [250, 120, 10]


def test_what_is_told_holds_behind_gzip_too(tmp_path: Path) -> None:
    plain = written(tmp_path, np.c_[np.arange(600) ** 1.5, BALL])
    (tmp_path / "packed.xyz.gz").write_bytes(gzip.compress(plain.read_bytes()))
    capture = read_capture(tmp_path / "packed.xyz.gz", reading=FileReading("x=2,y=3,z=4", "mm"))
    np.testing.assert_allclose(coordinates(capture), BALL, atol=1e-6)
    assert capture.metres_per_unit == METRES["mm"]


def test_columns_that_are_told_come_before_a_header(tmp_path: Path) -> None:
    lines = ["x;y;z", *(f"{a};{b};{c}" for a, b, c in BALL.tolist())]
    (tmp_path / "scan.csv").write_text("\n".join(lines))
    capture = read_capture(tmp_path / "scan.csv", reading=FileReading("x=3,y=1,z=2"))
    np.testing.assert_allclose(coordinates(capture), BALL[:, [2, 0, 1]], atol=1e-6)


def _table(folder: Path) -> Path:
    return written(folder, BALL)


def _array(folder: Path) -> Path:
    np.save(folder / "scan.npy", BALL)
    return folder / "scan.npy"


@pytest.mark.parametrize(("write", "columns"), [(_table, "x=2,y=3,z=4"), (_array, "x=1,y=2,z=3")])
def test_columns_that_are_not_there_are_named(write: Callable[[Path], Path], columns: str, tmp_path: Path) -> None:
    with pytest.raises(CaptureError) as caught:
        read_capture(write(tmp_path), reading=FileReading(columns))
    assert caught.value.code == "CAPTURE_UNREADABLE"
    assert caught.value.hints


def test_a_doubt_is_a_question_with_answers(tmp_path: Path) -> None:
    capture = read_capture(written(tmp_path, in_degrees(30 * BALL)))
    (question,) = questions_of(capture.warnings)
    assert question["text"] in capture.warnings
    assert [answer["options"] for answer in question["answers"]] == [
        {"unit": "m"},
        {"unit": "deg", "columns": "x=2,y=1,z=3"},
    ]
    assert flags_of(question) == "--unit m or --unit deg --columns x=2,y=1,z=3"
