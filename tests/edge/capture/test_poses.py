"""Rotations, cameras and image headers, each against its definition."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from capture2vr.edge.capture.depth import zero_invalid_depth
from capture2vr.edge.capture.files import number_order
from capture2vr.edge.capture.frame_records import checked_intrinsics
from capture2vr.edge.capture.images import decode_depth, decode_rgb, header_size, image_size
from capture2vr.edge.capture.nouns import Intrinsics
from capture2vr.edge.capture.poses import checked_pose, pose_from_quaternion
from capture2vr.edge.clouds.colours import rgb8, unpack_rgb
from capture2vr.edge.errors import CaptureError

QUATERNIONS = arrays(np.float64, 4, elements=st.floats(-1, 1)).filter(lambda q: 0.6 < np.linalg.norm(q) < 1.9)


@given(xyzw=QUATERNIONS)
def test_quaternions_turn_as_scipy_turns_them(xyzw: np.ndarray) -> None:
    pose = pose_from_quaternion(np.array([1.0, 2.0, 3.0]), xyzw)
    np.testing.assert_allclose(pose[:3, :3], Rotation.from_quat(xyzw).as_matrix(), atol=1e-12)
    np.testing.assert_array_equal(pose[:, 3], [1, 2, 3, 1])


@given(xyzw=QUATERNIONS, noise=arrays(np.float64, (3, 3), elements=st.floats(-2e-3, 2e-3)))
def test_a_pose_with_rounding_becomes_the_nearest_rotation(xyzw: np.ndarray, noise: np.ndarray) -> None:
    pose = pose_from_quaternion(np.zeros(3), xyzw)
    rounded = pose.copy()
    rounded[:3, :3] += noise
    checked = checked_pose(rounded, axes="opencv", file="f")
    np.testing.assert_allclose(checked[:3, :3] @ checked[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.abs(checked - pose).max() < 1e-2


def test_an_opengl_camera_looks_along_minus_z() -> None:
    """OpenCV's forward, +Z, must be OpenGL's -Z, and down its -Y."""
    pose = checked_pose(np.eye(4), axes="opengl", file="f")
    np.testing.assert_array_equal(pose[:3, :3] @ [0, 0, 1], [0, 0, -1])
    np.testing.assert_array_equal(pose[:3, :3] @ [0, 1, 0], [0, -1, 0])
    np.testing.assert_array_equal(pose[:3, :3] @ [1, 0, 0], [1, 0, 0])


@pytest.mark.parametrize(
    "matrix",
    [
        np.full((4, 4), np.nan),
        pose_from_quaternion(np.zeros(3), np.zeros(4)),
        pose_from_quaternion(np.array([np.nan, 0, 0]), np.array([0.0, 0, 0, 1])),
        np.diag([1.0, 1, -1, 1]),
        np.diag([1.05, 1, 1, 1]),
        np.zeros((4, 4)),
        np.eye(4) + np.outer([0, 0, 0, 1], [1, 0, 0, 0]),
        np.eye(4) + np.outer([1e9, 0, 0, 0], [0, 0, 0, 1]),
    ],
)
def test_what_is_no_pose_is_named(matrix: np.ndarray) -> None:
    with pytest.raises(CaptureError) as caught:
        checked_pose(matrix, axes="opencv", file="f")
    assert caught.value.code == "CAPTURE_BAD_POSE"


@pytest.mark.parametrize(
    "change", [{"fx": 0.0}, {"fy": -5.0}, {"fx": np.nan}, {"cx": np.inf}, {"cy": 1e4}, {"width": 0}, {"fx": 1e7}]
)
def test_cameras_that_cannot_be_are_named(change: dict[str, float]) -> None:
    values = {"fx": 500.0, "fy": 500.0, "cx": 320.0, "cy": 240.0, "width": 640, "height": 480} | change
    with pytest.raises(CaptureError) as caught:
        checked_intrinsics(Intrinsics(**values), "f")  # type: ignore[arg-type]
    assert caught.value.code == "CAPTURE_BAD_INTRINSICS"


@given(width=st.integers(1, 70), height=st.integers(1, 70), suffix=st.sampled_from([".png", ".jpg", ".tiff"]))
def test_headers_tell_the_size(width: int, height: int, suffix: str) -> None:
    data = cv2.imencode(suffix, np.zeros((height, width), np.uint8))[1].tobytes()
    assert header_size(data) == (width, height)


@pytest.mark.parametrize("suffix", [".tif", ".jpg"])
def test_a_size_behind_much_else_is_found(suffix: str, tmp_path: Path) -> None:
    """OpenCV writes a TIFF's header behind its pixels; a phone writes a map of depths before a JPEG's size."""
    pixels = np.random.default_rng(0).integers(1, 60_000, (480, 640)).astype(np.uint16)
    data = cv2.imencode(suffix, pixels if suffix == ".tif" else np.zeros((480, 640), np.uint8))[1].tobytes()
    if suffix == ".jpg":
        data = data[:2] + (b"\xff\xe1\xff\xff" + bytes(65_533)) * 20 + data[2:]
    (tmp_path / f"0{suffix}").write_bytes(data)
    assert image_size(tmp_path / f"0{suffix}", "0") == (640, 480)
    assert header_size(data) == (640, 480)
    if suffix == ".tif":
        np.testing.assert_array_equal(decode_depth(data, "0"), pixels)
    else:
        assert decode_rgb(data, "0").shape == (480, 640, 3)


@given(
    data=st.binary(max_size=200), magic=st.sampled_from([b"\xff\xd8", b"\x89PNG\r\n\x1a\n", b"II*\0", b"MM\0*", b""])
)
def test_headers_of_rubbish_raise_nothing(data: bytes, magic: bytes) -> None:
    header_size(magic + data)


def test_colours_of_every_range() -> None:
    expected = np.array([[0, 128, 255]], np.uint8)
    for values in (expected, expected / 255.0, expected.astype(np.float32), expected.astype(np.uint16) * 257):
        np.testing.assert_array_equal(rgb8(values), expected)
    np.testing.assert_array_equal(rgb8(np.array([[np.nan, np.inf, 0.5]])), [[0, 0, 128]])
    word = struct.unpack("<I", bytes([3, 2, 1, 255]))[0]
    np.testing.assert_array_equal(unpack_rgb(np.array([word], np.uint32)), [[1, 2, 3]])


def test_unknown_depth_is_zero() -> None:
    depth = np.array([[np.nan, -1, 0, 2.5, np.inf, 65.535, 5_000]], np.float32)
    np.testing.assert_allclose(zero_invalid_depth(depth), [[0, 0, 0, 2.5, 0, 65.535, 0]])


def test_numbers_in_names_are_in_order() -> None:
    names = ["10.png", "9.png", "frame_2.json", "frame_10.json", "a", ""]
    assert sorted(names, key=number_order) == ["", "9.png", "10.png", "a", "frame_2.json", "frame_10.json"]
