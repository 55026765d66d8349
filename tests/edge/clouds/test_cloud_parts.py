"""Clouds of more than four million points: some are kept, all are read again in parts."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from capture2vr.edge.arrays import Floats, no_tick
from capture2vr.edge.capture.nouns import Capture, Cloud
from capture2vr.edge.clouds.cloud_parts import projected, projected_parts, read_some
from capture2vr.edge.clouds.raw_parts import RawPart, RawParts
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.read_capture import read_capture
from capture2vr.order.reading import FileReading
from tests.support.captures import e57_scan, save_e57, splat_ply_bytes

COUNT = 50_003
GEOREFERENCED = np.array([500_000.0, 5_000_000.0, 100.0])


@pytest.fixture
def small_is_large(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reads files in parts from fewer points on, because one of four million takes seconds to write."""
    for module in ("e57", "las", "ply", "tables", "cloud_parts"):
        monkeypatch.setattr(f"capture2vr.edge.clouds.{module}.LARGE", 20_000)


def square(count: int) -> Floats:
    """Points (N,3) of a flat square of 40 m, row by row."""
    side = int(count**0.5) + 1
    row, column = np.divmod(np.arange(count), side)
    return np.stack([40 * column / side, 40 * row / side, 0.1 * np.sin(column / 50)], axis=1)


def raw(xyz: Floats, colours: np.ndarray[tuple[int, int], np.dtype[np.uint16]] | None = None) -> RawParts:
    def read() -> Iterator[RawPart]:
        for rows in np.array_split(np.arange(len(xyz)), 3):
            yield RawPart(xyz[rows], None if colours is None else colours[rows])

    return RawParts(len(xyz), read)


def everything(capture: Capture) -> Cloud:
    assert capture.whole is not None
    parts = list(capture.whole.read())
    colours = [part.rgb for part in parts if part.rgb is not None]
    return Cloud(np.concatenate([part.xyz for part in parts]), np.concatenate(colours) if colours else None)


@pytest.mark.usefixtures("small_is_large")
def test_a_large_ply_is_read_in_parts(tmp_path: Path) -> None:
    xyz = square(COUNT)
    records = np.zeros(
        COUNT, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1")]
    )
    for axis, name in enumerate("xyz"):
        records[name] = xyz[:, axis]
    records["green"] = 7
    properties = "".join(f"property float {name}\n" for name in "xyz")
    properties += "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {COUNT}\n{properties}end_header\n"
    path = tmp_path / "scan.ply"
    path.write_bytes(head.encode() + records.tobytes())
    capture = read_capture(path)
    assert capture.cloud is not None
    assert len(capture.cloud.xyz) == -(-COUNT // 3)
    whole = everything(capture)
    assert np.array_equal(whole.xyz, xyz.astype(np.float32))
    assert whole.rgb is not None
    assert (whole.rgb == (0, 7, 0)).all()


@pytest.mark.usefixtures("small_is_large")
@pytest.mark.parametrize("suffix", ["las", "laz"])
def test_a_large_las_is_read_in_parts(tmp_path: Path, suffix: str) -> None:
    import laspy

    header = laspy.LasHeader(point_format=2, version="1.2")
    header.scales, header.offsets = np.full(3, 1e-3), GEOREFERENCED
    scan = laspy.LasData(header)
    xyz = square(COUNT)
    scan.x, scan.y, scan.z = (xyz + GEOREFERENCED).T
    scan.red = scan.green = scan.blue = np.full(COUNT, 65_535, np.uint16)
    scan.write(tmp_path / f"scan.{suffix}")
    capture = read_capture(tmp_path / f"scan.{suffix}")
    assert any("georeferenced" in warning for warning in capture.warnings)
    whole = everything(capture)
    assert len(whole.xyz) == COUNT
    assert np.abs(whole.xyz - (xyz - np.floor(xyz.min(axis=0) + GEOREFERENCED) + GEOREFERENCED)).max() < 2e-3
    assert whole.rgb is not None
    assert (whole.rgb == 255).all()


@pytest.mark.slow
@pytest.mark.usefixtures("small_is_large")
def test_all_scans_of_a_large_e57_are_read_in_parts(tmp_path: Path) -> None:
    halves = np.array_split(square(COUNT), 2)
    save_e57(tmp_path / "scan.e57", [e57_scan(half, np.full(half.shape, 9, np.uint8)) for half in halves])
    capture = read_capture(tmp_path / "scan.e57")
    whole = everything(capture)
    assert whole.xyz == pytest.approx(square(COUNT), abs=1e-5)
    assert whole.rgb is not None
    assert (whole.rgb == 9).all()


@pytest.mark.usefixtures("small_is_large")
def test_all_parts_of_degrees_lie_on_one_map(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("capture2vr.edge.clouds.tables.PART", 10_000)
    metres = square(COUNT)
    metres[::1_000] = 0  # what a scanner writes where nothing came back
    seen = metres.any(axis=1)
    degrees = np.where(seen[:, None], metres / (76_055.9, 111_174.2, 1) + (8, 47, 400), 0)
    np.save(tmp_path / "scan.npy", degrees)
    capture = read_capture(tmp_path / "scan.npy", reading=FileReading(unit="deg"))
    assert capture.cloud is not None
    assert 'PARAMETER["central_meridian",8.0' in capture.cloud.crs
    np.testing.assert_array_equal(np.asarray(capture.up), [0, 0, 1])
    whole, truth = everything(capture).xyz, metres[seen]
    np.testing.assert_allclose(whole - whole[0], truth - truth[0], atol=2e-3)


@pytest.mark.usefixtures("small_is_large")
def test_a_scan_without_colours_of_a_large_e57_is_grey(tmp_path: Path) -> None:
    first, second = np.array_split(square(COUNT), 2)
    scans = [e57_scan(first, np.full(first.shape, 9, np.uint8)), e57_scan(second)]
    save_e57(tmp_path / "scan.e57", scans)
    capture = read_capture(tmp_path / "scan.e57")
    whole = everything(capture)
    assert whole.rgb is not None
    assert (whole.rgb == np.repeat([9, 128], [len(first), len(second)])[:, None]).all()
    assert f"{len(second):,} of {COUNT:,} points are of scans without colours" in capture.warnings[0]


@pytest.mark.usefixtures("small_is_large")
def test_a_large_file_of_splats_is_read_in_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With parts of which some have no splat that can be seen."""
    monkeypatch.setattr("capture2vr.edge.clouds.ply.PART", 10_000)
    seen = np.arange(COUNT) < 25_000
    opacity, rgb = np.where(seen, 0.9, 0.01), np.full((COUNT, 3), (200, 100, 50))
    (tmp_path / "scan.ply").write_bytes(splat_ply_bytes(square(COUNT), rgb, opacity))
    capture = read_capture(tmp_path / "scan.ply")
    whole = everything(capture)
    assert np.array_equal(whole.xyz, square(COUNT)[seen].astype(np.float32))
    assert whole.rgb is not None
    assert (whole.rgb == (200, 100, 50)).all()
    assert "Gaussian splats" in capture.warnings[0]


@pytest.mark.usefixtures("small_is_large")
def test_a_large_npy_is_read_in_parts(tmp_path: Path) -> None:
    np.save(tmp_path / "scan.npy", np.column_stack([square(COUNT), np.full((COUNT, 3), 128.0)]).astype(np.float32))
    whole = everything(read_capture(tmp_path / "scan.npy"))
    assert np.array_equal(whole.xyz, square(COUNT).astype(np.float32))
    assert whole.rgb is not None
    assert (whole.rgb == 128).all()


@pytest.mark.usefixtures("small_is_large")
def test_all_parts_of_a_table_have_one_layout_and_one_range(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Alone, the first part would be x y z r g b i, with colours of 0 to 1."""
    monkeypatch.setattr("capture2vr.edge.clouds.tables.PART", 10_000)
    intensity, colours = np.zeros((COUNT, 1)), np.ones((COUNT, 3))
    intensity[COUNT // 2 :], colours[COUNT // 2 :] = 1_000, (30, 20, 10)
    np.save(tmp_path / "scan.npy", np.hstack([square(COUNT), intensity, colours]))
    capture = read_capture(tmp_path / "scan.npy")
    assert capture.cloud is not None
    assert capture.cloud.rgb is not None
    assert np.array_equal(np.unique(capture.cloud.rgb, axis=0), [(1, 1, 1), (30, 20, 10)])
    whole = everything(capture)
    assert whole.rgb is not None
    assert np.array_equal(whole.rgb, colours)


def test_invalid_points_are_left_out_of_every_part() -> None:
    xyz = square(1_000)
    xyz[::20] = np.nan
    cloud, whole, warnings = read_some(raw(xyz), "scan.ply", no_tick)
    assert len(cloud.xyz) == sum(len(part.xyz) for part in whole.read()) == 950
    assert "dropped" in warnings[0]


def test_too_many_invalid_points_are_an_error() -> None:
    xyz = square(1_000)
    xyz[::5] = 1e30
    with pytest.raises(CaptureError, match="not finite") as error:
        read_some(raw(xyz), "scan.ply", no_tick)
    assert error.value.code == "CAPTURE_NOT_FINITE"


@pytest.mark.parametrize(("bright", "expected"), [(100, 1), (1, 200)])
def test_what_most_colours_of_all_parts_reach_decides_the_range(bright: int, expected: int) -> None:
    colours = np.full((900, 3), (200, 200, 199), np.uint16)
    colours[-bright:] = (65_535, 65_535, 65_534)
    _, whole, _ = read_some(raw(square(900), colours), "scan.las", no_tick)
    first = next(iter(whole.read()))
    assert first.rgb is not None
    assert (first.rgb[:, 0] == expected).all()


def test_a_part_that_cannot_be_decoded_names_the_file() -> None:
    def read() -> Iterator[RawPart]:
        yield RawPart(square(100), None)
        raise ValueError("the chunk is damaged")

    with pytest.raises(CaptureError, match=r"scan.las: is not a readable point cloud \(the chunk is damaged\)"):
        read_some(RawParts(200, read), "scan.las", no_tick)


def test_a_part_in_degrees_that_cannot_be_decoded_names_the_file() -> None:
    def broken() -> Iterator[RawPart]:
        raise ValueError("no")
        yield raw(square(2))

    with pytest.raises(CaptureError) as caught:
        projected_parts(RawParts(10, broken), "scan.ply")
    assert (caught.value.code, caught.value.file) == ("CAPTURE_UNREADABLE", "scan.ply")


def test_degrees_that_were_moved_are_projected_where_they_were() -> None:
    """As a place that is far off moves a whole file near the origin."""
    degrees = np.array([[8.0, 47, 400], [8.00001, 47.00001, 401]])
    origin = np.array([0.0, 40, -2e6])
    found = projected(Cloud(degrees - origin, origin=origin))
    assert found.origin is None
    np.testing.assert_allclose(found.xyz, projected(Cloud(degrees)).xyz, atol=1e-6)
