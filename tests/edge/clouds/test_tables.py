"""Tables of points mean what their writers meant: encodings, separators, decimal marks, headers, and odd rows."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings

from capture2vr.edge.capture.text_encoding import encoding_of
from capture2vr.edge.clouds import table_text
from capture2vr.edge.clouds.tables import read_table
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.read_capture import read_capture
from tests.support.odd_tables import OddTable, odd_tables

RNG = np.random.default_rng(5)
TURN = RNG.normal(size=(400, 3))
XYZ = np.round(TURN / np.linalg.norm(TURN, axis=1, keepdims=True) * (0.6, 0.4, 0.2) + (2.5, 0.1, 1.2), 4)
RGB = RNG.integers(1, 256, (400, 3))
KEPT = np.arange(400) % 20 != 7


@pytest.mark.slow
@settings(max_examples=300)
@given(odd_tables)
def test_what_is_written_is_what_is_read(table: OddTable) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scan.txt"
        path.write_bytes(table.written(XYZ, RGB))
        cloud = read_capture(path).cloud
    assert cloud is not None
    np.testing.assert_allclose(cloud.xyz, XYZ[KEPT], atol=1e-9)
    if table.coloured:
        np.testing.assert_array_equal(cloud.rgb, RGB[KEPT])
    else:
        assert cloud.rgb is None


PLAIN = OddTable(header=("x", "y", "z"), separator=",")


@pytest.mark.parametrize(
    ("data", "xyz"),
    [
        # Two numbers in a field are not one: the tabs separate, whatever the commas could do.
        (b"4,830\t3,232\t0,000\n6,000\t0,181\t0,122\n", [(4.83, 3.232, 0), (6, 0.181, 0.122)]),
        (b"1.234,5;2.345.678,25;0,5\n7,5;8,25;9,125\n", [(1234.5, 2345678.25, 0.5), (7.5, 8.25, 9.125)]),
        (b"1,234.5\t2\t3\n7\t8\t9\n", [(1234.5, 2, 3), (7, 8, 9)]),
        (b"1,2,3 255,0,0\n4,5,6 0,255,0\n", [(1, 2, 3), (4, 5, 6)]),
        (b'"1,5","2,5","3,5"\n"4,5","5,5","6,5"\n', [(1.5, 2.5, 3.5), (4.5, 5.5, 6.5)]),
        (b"1.0D+01 2.0d0 3\n4 5 6\n", [(10, 2, 3), (4, 5, 6)]),
        (b"1 2 3;\n4 5 6;\n", [(1, 2, 3), (4, 5, 6)]),
        (b"z;x;y\n1;2;3\n4;5;6\n", [(2, 3, 1), (5, 6, 4)]),
        (b"x y z\n1 1 2 3\n2 4 5 6\n", [(1, 2, 3), (4, 5, 6)]),  # as R writes the numbers of its rows
        (b"lat,y,x,lon,height\n50.1,2,1,8.6,3\n50.2,5,4,8.7,6\n", [(1, 2, 3), (4, 5, 6)]),
    ],
)
def test_rows_are_read_as_they_are_written(data: bytes, xyz: list[tuple[float, ...]], tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_bytes(data)
    cloud, _, _ = read_table(tmp_path / "a.txt", "a.txt")
    np.testing.assert_allclose(cloud.xyz, xyz)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"Latitude;Longitude;Height\n50,1;8,6;120,5\n50,2;8,7;121\n", "degrees of latitude and longitude"),
        (b"time,ax,ay,az\n1,2,3,4\n2,3,4,5\n", "its columns are time, ax, ay, az"),
        (b"a line\nand another\n", "no rows of three numbers"),
        (b"x,y,z\n" + b"1" * 20_000 + b",2,3\n", "has a line of"),
    ],
)
def test_a_table_that_has_no_points_is_refused_by_its_reason(data: bytes, reason: str, tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_bytes(data)
    with pytest.raises(CaptureError, match=reason):
        read_table(tmp_path / "a.txt", "a.txt")


def test_what_was_taken_for_what_is_told(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_bytes(OddTable(separator=";", decimal=",", front="index").written(XYZ, RGB))
    assert "columns 2, 3 and 4 were taken for x, y and z, with decimal commas" in read_capture(tmp_path).warnings[0]
    (tmp_path / "a.txt").write_bytes(PLAIN.written(XYZ, RGB))
    assert "taken" not in " ".join(read_capture(tmp_path).warnings)


def test_the_unit_of_a_header_is_the_files(tmp_path: Path) -> None:
    table = OddTable(header=("X [mm]", "Y [mm]", "Z [mm]"), separator=";")
    (tmp_path / "a.csv").write_bytes(table.written(1000 * XYZ, RGB))
    capture = read_capture(tmp_path)
    assert (capture.metres_per_unit, capture.scale_confidence) == (0.001, "metric")


@pytest.mark.parametrize("share", [0.3, 0.9])
def test_points_without_a_return_may_be_any_share(share: float, tmp_path: Path) -> None:
    empty = np.arange(len(XYZ)) < share * len(XYZ)
    for nothing in (np.nan, 0.0):
        xyz = np.concatenate([np.where(empty[:, None], nothing, XYZ + moved) for moved in (0, 1e-3, 2e-3)])
        np.savetxt(tmp_path / "a.xyz", xyz)
        capture = read_capture(tmp_path / "a.xyz")
        assert capture.cloud is not None
        assert len(capture.cloud.xyz) == 3 * int((~empty).sum())
        assert "were dropped" in capture.warnings[0]


def test_a_large_table_is_read_in_pieces_of_whole_lines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for encoding, ends in (("utf-8", "\r\n"), ("utf-16", "\n"), ("cp1252", "\r")):
        text = OddTable(encoding=encoding, ends=ends, before=("Müller",)).written(XYZ, RGB)
        (tmp_path / "a.txt").write_bytes(text)
        plain = text.decode(encoding).replace("\r\n", "\n").replace("\r", "\n")
        for size in (7, 64, 1_000):
            monkeypatch.setattr(table_text, "PIECE", size)
            found = list(table_text.pieces(tmp_path / "a.txt", *encoding_of(text)))
            assert "".join(found) == plain
            assert all(each.endswith("\n") for each in found)


def test_a_line_without_an_end_is_not_joined(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table_text, "PIECE", 64)
    monkeypatch.setattr(table_text, "_LONGEST", 1_000)
    (tmp_path / "a.txt").write_bytes(b"1 2 3\n" + b"1" * 20_000)
    found = list(table_text.pieces(tmp_path / "a.txt", "utf-8", 0))
    assert max(map(len, found)) < 1_100
    assert "".join(found) == "1 2 3\n" + "1" * 20_000
