"""Text files beside frames: cameras and poses are read from them, points never are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.edge.capture.calibration import camera_matrix, is_side_table
from capture2vr.edge.capture.files import open_folder
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.read_capture import read_capture
from tests.support import captures

K = f"{captures.FOCAL} 0 {captures.CX}\n0 {captures.FOCAL} {captures.CY}\n0 0 1\n"
CALIBRATIONS = {
    "cam.info": K,
    "calib.txt": "P0: " + " ".join([*K.split()[:3], "0", *K.split()[3:6], "0", *K.split()[6:], "0"]) + "\n",
    "kinect.cam": f"width: {captures.WIDTH}\nheight: {captures.HEIGHT}\n"
    f"fx: {captures.FOCAL}\nfy: {captures.FOCAL}\ncx: {captures.CX}\ncy: {captures.CY}\n",
    "camera.yaml": f"camera:\n  fx: {2 * captures.FOCAL}\n  fy: {2 * captures.FOCAL}\n  cx: {2 * captures.CX + 0.5}\n"
    f"  cy: {2 * captures.CY + 0.5}\n  width: {2 * captures.WIDTH}\n  height: {2 * captures.HEIGHT}\n",
}


def turned(count: int) -> np.ndarray:
    return np.stack(captures.poses(count))


def rows(table: np.ndarray) -> str:
    return "\n".join(" ".join(f"{value:.6f}" for value in row) for row in table.reshape(len(table), -1)) + "\n"


TABLES = {
    "poses of 12": rows(turned(120)[:, :3]),
    "poses of 16": rows(turned(120)),
    "times and quaternions": rows(
        np.array([[n / 30, *pose[:3, 3], *captures.quaternion(pose[:3, :3])] for n, pose in enumerate(turned(120))])
    ),
    "a gyroscope": rows(np.column_stack([np.arange(400) / 100, np.random.default_rng(0).normal(size=(400, 6))])),
    "a few rows": rows(np.random.default_rng(0).normal(size=(20, 3))),
    **CALIBRATIONS,
}  # fmt: skip


@pytest.mark.parametrize("name", TABLES)
def test_a_table_beside_pictures_is_never_a_cloud(name: str, tmp_path: Path) -> None:
    for index in range(4):
        captures.save_jpg(tmp_path / f"IMG_{index}.jpg", captures.picture(index))
    (tmp_path / "cam.info").write_text(TABLES[name])
    capture = read_capture(tmp_path)
    assert (capture.kind, len(capture.photos)) == ("photos", 4)


@given(st.integers(100, 400), st.integers(3, 10), st.integers(0, 10**6))
def test_a_cloud_beside_pictures_stays_one(count: int, columns: int, seed: int) -> None:
    from tempfile import TemporaryDirectory

    with TemporaryDirectory() as name:
        folder = Path(name)
        captures.save_jpg(folder / "IMG_1.jpg", captures.picture(1))
        (folder / "scan.txt").write_text(rows(np.random.default_rng(seed).normal(size=(count, columns))))
        assert not is_side_table(open_folder(folder), "scan.txt")


@pytest.mark.parametrize("name", CALIBRATIONS)
@pytest.mark.parametrize("layout", ["open3d", "7scenes"])
def test_depth_frames_find_their_camera_in_a_text_file(layout: str, name: str, tmp_path: Path) -> None:
    if layout == "open3d":
        folder = captures.write_open3d(tmp_path)
        (folder / "camera.json").unlink()
    else:
        folder = tmp_path
        for index, pose in enumerate(captures.poses()):
            captures.save_png(folder / f"frame-{index:06}.depth.png", captures.steps(captures.depth_m(pose)))
            (folder / f"frame-{index:06}.pose.txt").write_text(rows(pose))
    (folder / name).write_text(CALIBRATIONS[name])
    capture = read_capture(folder)
    assert capture.kind == "rgbd"
    camera = capture.frames[0].intrinsics.scaled_to(captures.WIDTH, captures.HEIGHT)
    assert (camera.fx, camera.fy) == (captures.FOCAL, captures.FOCAL)
    assert (camera.cx, camera.cy) == pytest.approx((captures.CX, captures.CY))


@pytest.mark.parametrize("text", ["", "1 2 3\n4 5 6\n7 8 9\n", "0 0 0\n0 0 0\n0 0 1\n", "-5 0 3\n0 5 3\n0 0 1\n"])
def test_other_numbers_are_no_camera(text: str) -> None:
    assert camera_matrix(text) is None


def test_kittis_photos_come_with_their_cameras(tmp_path: Path) -> None:
    capture = read_capture(captures.write_kitti(tmp_path))
    assert (capture.kind, capture.format, capture.scale_confidence) == ("photos", "kitti", "metric")
    assert len(capture.photos) == 12
    for photo, pose in zip(capture.photos, captures.poses(12), strict=True):
        assert photo.camera_to_world == pytest.approx(pose, abs=1e-6)
        assert photo.intrinsics is not None
        assert (photo.intrinsics.fx, photo.intrinsics.cx) == pytest.approx(
            (captures.colour_camera()[0], captures.colour_camera()[2])
        )


def test_kitti_without_poses_is_photos(tmp_path: Path) -> None:
    folder = captures.write_kitti(tmp_path)
    (folder / "poses.txt").unlink()
    capture = read_capture(folder)
    assert (capture.format, len(capture.photos)) == ("photos", 12)
    assert capture.photos[0].camera_to_world is None


def test_kitti_without_the_lines_of_its_camera_names_the_file(tmp_path: Path) -> None:
    folder = captures.write_kitti(tmp_path)
    text = (folder / "calib.txt").read_text()
    (folder / "calib.txt").write_text(text.replace("P2:", "P9:"))
    with pytest.raises(CaptureError) as caught:
        read_capture(folder)
    assert (caught.value.code, caught.value.file) == ("CAPTURE_UNREADABLE", "calib.txt")


def test_half_of_kittis_poses_are_too_few(tmp_path: Path) -> None:
    folder = captures.write_kitti(tmp_path)
    lines = (folder / "poses.txt").read_text().splitlines()
    (folder / "poses.txt").write_text("\n".join(lines[:6]) + "\n")
    with pytest.raises(CaptureError) as caught:
        read_capture(folder)
    assert caught.value.code == "CAPTURE_COUNT_MISMATCH"


# E57


XYZ, RGB, _ = captures.sphere()


def test_scans_of_an_e57_are_placed_by_their_poses_and_keep_their_colours(tmp_path: Path) -> None:
    place = captures.poses()[1]
    path = tmp_path / "scan.e57"
    captures.save_e57(path, [captures.e57_scan(XYZ, RGB)] * 2, [np.eye(4), place])
    capture = read_capture(path)
    assert capture.cloud is not None
    assert (capture.format, capture.scale_confidence) == ("e57", "metric")
    assert capture.cloud.xyz[:500] == pytest.approx(XYZ, abs=1e-9)
    assert capture.cloud.xyz[500:] == pytest.approx(XYZ @ place[:3, :3].T + place[:3, 3], abs=1e-9)
    assert np.array_equal(capture.cloud.rgb, np.tile(RGB, (2, 1)))


def test_points_that_the_scanner_calls_invalid_are_left_out(tmp_path: Path) -> None:
    invalid = (np.arange(len(XYZ)) % 10 == 0).astype(np.int8)
    scan = captures.e57_scan(XYZ, RGB) | {"cartesianInvalidState": invalid}
    captures.save_e57(tmp_path / "scan.e57", [scan])
    cloud = read_capture(tmp_path).cloud
    assert cloud is not None
    assert np.array_equal(cloud.rgb, RGB[invalid == 0])


@pytest.mark.parametrize("order", [1, -1])
def test_a_scan_without_colours_is_grey_beside_one_that_has_them(order: int, tmp_path: Path) -> None:
    captures.save_e57(tmp_path / "scan.e57", [captures.e57_scan(XYZ, RGB), captures.e57_scan(XYZ)][::order])
    capture = read_capture(tmp_path)
    assert capture.cloud is not None
    assert np.array_equal(capture.cloud.rgb, np.concatenate([RGB, np.full_like(RGB, 128)][::order]))
    (warning,) = capture.warnings
    assert warning.startswith("scan.e57: 500 of 1,000 points are of scans without colours")


def test_without_colours_in_any_scan_there_are_none(tmp_path: Path) -> None:
    captures.save_e57(tmp_path / "scan.e57", [captures.e57_scan(XYZ)] * 2)
    capture = read_capture(tmp_path)
    assert capture.cloud is not None
    assert len(capture.cloud.xyz) == 1000
    assert capture.cloud.rgb is None
    assert capture.warnings == ()


def test_georeferenced_scans_are_moved_near_the_origin(tmp_path: Path) -> None:
    far = np.eye(4)
    far[:3, 3] = [431_000, 5_412_000, 120]
    captures.save_e57(tmp_path / "scan.e57", [captures.e57_scan(XYZ, RGB)], [far])
    capture = read_capture(tmp_path)
    assert capture.cloud is not None
    assert np.abs(capture.cloud.xyz).max() < 10
    assert "georeferenced" in capture.warnings[0]


@pytest.mark.parametrize(
    ("spoil", "code"),
    [
        (lambda data: data[:-1500], "CAPTURE_TRUNCATED"),
        (lambda data: data[:30], "CAPTURE_TRUNCATED"),
        (lambda data: data[:2000] + b"\xff" * 40 + data[2040:], "CAPTURE_UNREADABLE"),
        (lambda data: data[:40] + bytes(8) + data[48:], "CAPTURE_UNREADABLE"),
        (lambda data: data.replace(b'recordCount="500"', b'recordCount="0"  '), "CAPTURE_EMPTY"),
        (lambda data: data.replace(b'recordCount="500"', b'recordCount="9999999999"'), "CAPTURE_TOO_LARGE"),
    ],
)  # fmt: skip
def test_a_broken_e57_has_its_code(spoil: object, code: str, tmp_path: Path) -> None:
    assert callable(spoil)
    captures.save_e57(tmp_path / "whole.e57", [captures.e57_scan(XYZ, RGB)])
    path = tmp_path / "scan.e57"
    path.write_bytes(spoil((tmp_path / "whole.e57").read_bytes()))
    with pytest.raises(CaptureError) as caught:
        read_capture(path)
    assert (caught.value.code, caught.value.file) == (code, "scan.e57")
    assert caught.value.hints
