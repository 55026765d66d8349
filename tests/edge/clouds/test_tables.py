"""Tables of points mean what their writers meant: encodings, separators, decimal marks, headers, and odd rows."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture2vr.edge.capture.text_encoding import encoding_of
from capture2vr.edge.clouds import table_text
from capture2vr.edge.clouds.column_names import meaning_of, metres_of
from capture2vr.edge.clouds.table_dialect import Dialect
from capture2vr.edge.clouds.table_rows import shown_rows
from capture2vr.edge.clouds.tables import read_table
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.read_capture import read_capture
from capture2vr.order.questions import questions_of
from capture2vr.order.reading import TableColumns
from capture2vr.sentences.sentence import Sentence, read_sentence
from tests.support.odd.tables import OddTable, odd_tables

RNG = np.random.default_rng(5)
TURN = RNG.normal(size=(400, 3))
XYZ = np.round(TURN / np.linalg.norm(TURN, axis=1, keepdims=True) * (0.6, 0.4, 0.2) + (2.5, 0.1, 1.2), 4)
RGB = RNG.integers(1, 256, (400, 3))
KEPT = np.arange(400) % 20 != 7


@pytest.mark.slow
@settings(max_examples=300, deadline=None)
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
        (b"name;x;y;z\na;1;2;3;\nb;4;5;6;\n", [(1, 2, 3), (4, 5, 6)]),  # only the rows end with a separator
        (b"# z;x;y;note\n1;2;3;\n4;5;6;\n", [(2, 3, 1), (5, 6, 4)]),
        (b"'1,234.5',2,3\n'7,000.25',8,9\n".replace(b"'", b'"'), [(1234.5, 2, 3), (7000.25, 8, 9)]),
        (b"1'234.5;2'345'678.25;0.5\n7.5;8.25;9.125\n", [(1234.5, 2345678.25, 0.5), (7.5, 8.25, 9.125)]),
        (b"1 234,5;2 345 678,25;0,5\n7,5;8,25;9,125\n", [(1234.5, 2345678.25, 0.5), (7.5, 8.25, 9.125)]),
        ("1\u202f234,5;−8,25;0,5\n−7,5;8,25;9,125\n".encode(), [(1234.5, -8.25, 0.5), (-7.5, 8.25, 9.125)]),
        (b"1,5e+01;2,5e-01;3e0;7;8;9\n4,5E0;5,5e0;6e0;1;2;3\n", [(15, 0.25, 3), (4.5, 5.5, 6)]),
        (b"z;x;y\n1;2;3\n4;5;6\n", [(2, 3, 1), (5, 6, 4)]),
        (b"x y z\n1 1 2 3\n2 4 5 6\n", [(1, 2, 3), (4, 5, 6)]),  # as R writes the numbers of its rows
        (b"1,5;2,5;3,5\n4.5;0.500;-0.125\n1.234,5;2,5;3\n", [(1.5, 2.5, 3.5), (4.5, 0.5, -0.125), (1234.5, 2.5, 3)]),
        (
            b"1,5;2;3\n4.5;0.500;6.25\n1.234,5;2,5;3\n7;8;9\nend;;\n",
            [(1.5, 2, 3), (4.5, 0.5, 6.25), (1234.5, 2.5, 3), (7, 8, 9)],
        ),
        (b"1.5\t2\t3\n4,5\t5,5\t6,5\n1,234.5\t2\t3\n7 8\t9\t9\n6\t7\t8\n", [(1.5, 2, 3), (1234.5, 2, 3), (6, 7, 8)]),
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
        (b"Latitude;Longitude;Time\n50,1;8,6;120,5\n50,2;8,7;121\n", "its columns are latitude, longitude, time"),
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


@pytest.mark.parametrize(
    ("table", "code"),
    [
        (OddTable(separator=";", front="index"), "columns_taken"),
        (OddTable(separator=";", front="time"), "columns_taken"),
        (OddTable(separator=";", front="index", header=("X", "Y", "Z")), "columns_read"),
        (OddTable(separator=";", decimal=","), "columns_read"),
    ],
)
def test_only_columns_that_were_guessed_are_asked(table: OddTable, code: str, tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_bytes(table.written(XYZ, RGB))
    told = read_capture(tmp_path).warnings[0]
    assert isinstance(told, Sentence)
    assert told.code == code
    assert len(questions_of([told])) == (code == "columns_taken")


def test_a_question_about_columns_has_the_first_rows_and_no_texts(tmp_path: Path) -> None:
    """The values go into a published manifest: what people wrote into a scan is not for its readers."""
    table = OddTable(separator=";", front="name")
    (tmp_path / "a.txt").write_bytes(table.written(XYZ, RGB))
    (question,) = questions_of(read_capture(tmp_path).warnings)
    values = question["text"].values
    assert values["columns"] == "x=2,y=3,z=4,r=5,g=6,b=7"
    assert values["numbers"] == [1, 2, 3, 4, 5, 6, 7]
    assert values["rows"] == [
        ["…", *(f"{value:.4f}" for value in XYZ[row]), *map(str, RGB[row].tolist())] for row in range(4)
    ]
    assert read_sentence(question["text"].english, json.loads(json.dumps(question["text"].coded))).values == values


@settings(max_examples=30)
@given(
    st.lists(st.lists(st.text(st.characters(exclude_characters="\r\n\0"), max_size=30), max_size=40), max_size=9),
    st.lists(st.integers(0, 60), min_size=3, max_size=3, unique=True),
)
def test_shown_rows_are_few_short_and_have_what_was_taken(cells: list[list[str]], xyz: list[int]) -> None:
    dialect = Dialect(";", ".", quoted=False)
    shown = shown_rows([";".join(row) for row in cells], dialect, TableColumns(tuple(xyz)))
    assert {number + 1 for number in xyz} <= {*shown["numbers"]}
    assert len(shown["rows"]) <= 4
    assert {len(row) for row in shown["rows"]} <= {len(shown["numbers"])}
    assert len(shown["numbers"]) <= 15
    assert all(len(cell) <= 16 for row in shown["rows"] for cell in row)


@pytest.mark.parametrize("form", ["{} [mm]", "{}(mm)", "{}_mm", "{}/mm", "{} mm"])
def test_the_unit_of_a_header_is_the_files(form: str, tmp_path: Path) -> None:
    table = OddTable(header=tuple(map(form.format, "XYZ")), separator=";")
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


@pytest.mark.parametrize("part", ["_", " ", "/", "(", "[]", " m", "_deg"])
def test_a_name_of_many_marks_costs_no_more_than_its_length(part: str) -> None:
    """As long as a line may be; these took half a minute."""
    name = "n" + 10_000 // len(part) * part + "n"
    assert meaning_of(name) == name
    assert metres_of(name) is None


def test_columns_named_degrees_that_have_none_are_lengths(tmp_path: Path) -> None:
    np.savetxt(
        tmp_path / "a.csv", XYZ + np.array([500_000, 5_000_000, 0]), delimiter=",", header="lon,lat,height", comments=""
    )
    capture = read_capture(tmp_path / "a.csv")
    assert capture.cloud is not None
    np.testing.assert_allclose(np.ptp(capture.cloud.xyz, axis=0), np.ptp(XYZ, axis=0), atol=1e-6)
    assert "degrees_are_none" in {warning.code for warning in capture.warnings if isinstance(warning, Sentence)}
