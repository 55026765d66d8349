"""Files of scans: Leica's PTX, whose scans have poses, and any file of points or of a mesh behind gzip."""

from __future__ import annotations

import gzip
import struct
from pathlib import Path

import laspy
import numpy as np
import pytest

from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.clouds import raw_parts
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.read_capture import read_capture
from tests.support.clouds import sphere_points, write_ply

BALL = sphere_points(400).round(4)
TURNED = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])  # rows: where the scanner's axes point, a quarter turn about Z


def scan(
    points: np.ndarray, turn: np.ndarray, place: tuple[float, ...], *, rgb: bool = False, transposed: bool = False
) -> str:
    """A scan of a PTX, of 20 rows; its first three beams have no return."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[3, :3] = turn, place
    head = [f"{(len(points) + 20) // 20}", "20", *(" ".join(map(str, row)) for row in (place, *turn))]
    head += [" ".join(map(str, row)) for row in (matrix.T if transposed else matrix)]
    tint = " 10 20 30" if rgb else ""
    beams = [f"0 0 0 0.500000{' 0 0 0' if rgb else ''}"] * 20
    beams += [f"{x} {y} {z} {0.1 + 0.8 * abs(x):.3f}{tint}" for x, y, z in points]
    return "\n".join(head + beams) + "\n"


def read(path: Path, data: str | bytes) -> Capture:
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return read_capture(path)


@pytest.mark.parametrize("transposed", [False, True])
def test_every_scan_of_a_ptx_is_placed_by_its_matrix(tmp_path: Path, transposed: bool) -> None:
    text = scan(BALL, np.eye(3), (0, 0, 0)) + scan(BALL, TURNED, (10, 20, 1.5), transposed=transposed)
    capture = read(tmp_path / "hall.ptx", text)
    assert (capture.kind, capture.format, capture.scale_confidence) == ("points", "ptx", "metric")
    assert capture.cloud is not None
    x, y, z = BALL.T
    # A quarter turn about Z takes x to y, and y to -x.
    moved = np.stack([10 - y, 20 + x, 1.5 + z], axis=1)
    np.testing.assert_allclose(capture.cloud.xyz, np.concatenate([BALL, moved]), atol=1e-9)
    assert capture.cloud.rgb is not None
    assert (np.ptp(capture.cloud.rgb, axis=1) == 0).all(), "intensities are shades of grey"
    assert any("40 of 840" in warning for warning in capture.warnings), "beams without a return are counted"
    assert capture.up is not None
    assert capture.up.tolist() == [0, 0, 1]


def test_a_scan_without_colours_is_grey_beside_one_with_colours(tmp_path: Path) -> None:
    capture = read(tmp_path / "a.ptx", scan(BALL, np.eye(3), (0, 0, 0), rgb=True) + scan(BALL, TURNED, (5, 0, 0)))
    assert capture.cloud is not None
    assert capture.cloud.rgb is not None
    assert capture.cloud.rgb[0].tolist() == [10, 20, 30]
    assert capture.cloud.rgb[-1].tolist() == [128, 128, 128]
    assert any("made grey" in warning or "grey" in warning for warning in capture.warnings)


def test_a_ptx_of_windows_is_read(tmp_path: Path) -> None:
    text = scan(BALL, np.eye(3), (0, 0, 0)).replace("\n", "\r\n")
    capture = read(tmp_path / "a.ptx", text)
    assert capture.cloud is not None
    assert len(capture.cloud.xyz) == 400


PTX = scan(BALL, np.eye(3), (0, 0, 0))
BROKEN = {
    "cut off in a scan": (PTX[:-2000], "CAPTURE_TRUNCATED"),
    "cut off in the second header": (PTX + "\n".join(PTX.splitlines()[:5]), "CAPTURE_TRUNCATED"),
    "of a billion beams": (PTX.replace("21\n20\n", "50000\n20000\n"), "CAPTURE_TOO_LARGE"),
    "of ten million beams": (PTX.replace("21\n20\n", "5000\n2000\n"), "CAPTURE_TRUNCATED"),
    "of infinitely many": (PTX + PTX.replace("21\n20\n", "inf\n2\n", 1), "CAPTURE_TOO_LARGE"),
    "of negative numbers": (PTX + PTX.replace("21\n20\n", "-21\n-20\n", 1), "CAPTURE_TOO_LARGE"),
    "without a pose": (PTX.replace("0.0 0.0 0.0 1.0", "0.0 0.0 0.0 7.0"), "CAPTURE_UNREADABLE"),
    "with a row of five": (PTX.replace("0 0 0 0.500000", "0 0 0 0.5 1", 1), "CAPTURE_UNREADABLE"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_ptx_is_refused(tmp_path: Path, case: str) -> None:
    data, code = BROKEN[case]
    with pytest.raises(CaptureError) as caught:
        read(tmp_path / "hall.ptx", data)
    assert (caught.value.code, caught.value.file) == (code, "hall.ptx")


def test_a_head_of_blanks_is_soon_no_ptx(tmp_path: Path) -> None:
    with pytest.raises(CaptureError):
        read(tmp_path / "a.ptx", "5\n5\n0" + " " * 60_000 + "\n")


# ---- gzip ----


def _obj() -> bytes:
    rows = [f"v {x} {y} {z}" for x, y, z in BALL] + [f"f {n} {n + 1} {n + 2}" for n in range(1, 398)]
    return "\n".join(rows).encode()


def _stl() -> bytes:
    facets = b"".join(struct.pack("<12fH", *(0.0,) * 3, *BALL[n : n + 3].reshape(-1), 0) for n in range(100))
    return bytes(80) + struct.pack("<I", 100) + facets


def _pcd() -> bytes:
    head = (
        "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 400\nHEIGHT 1\nPOINTS 400\nDATA binary\n"
    )
    return head.encode() + BALL.astype("<f4").tobytes()


def _ply(folder: Path) -> bytes:
    return write_ply(folder / "plain", BALL).read_bytes()


def _las(folder: Path) -> bytes:
    las = laspy.create(point_format=3, file_version="1.2")
    las.header.scales = [1e-4] * 3
    las.x, las.y, las.z = BALL.T
    las.write(str(folder / "plain.las"))
    return (folder / "plain.las").read_bytes()


PLAIN = {
    "scan.ply.gz": ("ply", _ply),
    "scan.las.gz": ("las", _las),
    "scan.pcd.gz": ("pcd", lambda folder: _pcd()),
    "scan.xyz.gz": ("xyz", lambda folder: "\n".join(" ".join(map(str, row)) for row in BALL).encode()),
    "scan.csv.gz": ("xyz", lambda folder: ("x,y,z\n" + "\n".join(",".join(map(str, row)) for row in BALL)).encode()),
    "a name without an ending": ("ply", _ply),
    "hall.ptx.gz": ("ptx", lambda folder: PTX.encode()),
}


@pytest.mark.parametrize("name", PLAIN)
def test_points_behind_gzip_are_read(tmp_path: Path, name: str) -> None:
    kind, data = PLAIN[name]
    capture = read(tmp_path / name, gzip.compress(data(tmp_path)))
    assert capture.format == kind
    assert capture.cloud is not None
    assert np.abs(np.sort(capture.cloud.xyz, axis=0) - np.sort(BALL, axis=0)).max() < 1e-4


@pytest.mark.parametrize(("name", "data"), [("a.obj.gz", _obj()), ("a.stl.gz", _stl())])
def test_a_mesh_behind_gzip_is_read(tmp_path: Path, name: str, data: bytes) -> None:
    capture = read(tmp_path / name, gzip.compress(data))
    assert capture.cloud is not None
    assert capture.format == name[2:5]
    assert len(capture.cloud.xyz) > 1000


def test_a_large_cloud_behind_gzip_is_read_again_in_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("ply", "cloud_parts"):
        monkeypatch.setattr(f"capture2vr.edge.clouds.{module}.LARGE", 100)
    monkeypatch.setattr(raw_parts, "LARGE", 100)
    capture = read(tmp_path / "scan.ply.gz", gzip.compress(_ply(tmp_path)))
    assert capture.whole is not None
    for _ in range(2):
        assert sum(len(part.xyz) for part in capture.whole.read()) == 400


def test_a_bomb_behind_gzip_is_refused_as_of_a_zip(tmp_path: Path) -> None:
    bomb = gzip.compress(_ply(tmp_path)[:200] + bytes(20_000_000))
    with pytest.raises(CaptureError) as caught:
        read(tmp_path / "bomb.ply.gz", bomb)
    assert (caught.value.code, caught.value.file) == ("ARCHIVE_BOMB", "bomb.ply.gz")


def test_damage_behind_gzip_is_told(tmp_path: Path) -> None:
    with pytest.raises(CaptureError) as caught:
        read(tmp_path / "scan.ply.gz", gzip.compress(_ply(tmp_path))[:-400])
    assert (caught.value.code, caught.value.file) == ("ARCHIVE_BROKEN", "scan.ply.gz")
