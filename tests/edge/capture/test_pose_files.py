"""Folders with a pose file beside every depth image: lost frames, cameras in other files, and no poses at all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from capture2vr.edge.errors import CaptureError
from capture2vr.edge.read_capture import read_capture
from tests.support import captures

LOST = "-inf -inf -inf -inf\n" * 4


def test_frames_that_lost_their_tracking_are_left_out(tmp_path: Path) -> None:
    folder = captures.write_scannet(tmp_path)
    (folder / "pose/10.txt").write_text(LOST)
    capture = read_capture(folder)
    assert [frame.name for frame in capture.frames] == ["depth/0.png", "depth/20.png", "depth/30.png"]
    assert capture.warnings == ("tracking was lost in 1 of 4 frames, which are not used",)


def test_where_all_tracking_was_lost_there_are_no_poses(tmp_path: Path) -> None:
    folder = captures.write_scannet(tmp_path)
    for path in (folder / "pose").iterdir():
        path.write_text(LOST)
    with pytest.raises(CaptureError) as caught:
        read_capture(folder)
    assert caught.value.code == "CAPTURE_NO_POSES"


def test_the_camera_of_an_info_file_has_a_depth_scale_too(tmp_path: Path) -> None:
    folder = captures.write_7scenes(tmp_path)
    (folder / "camera-intrinsics.txt").unlink()
    f, cx, cy = captures.FOCAL, captures.CX, captures.CY
    matrix = f"{f} 0 {cx} 0 0 {f} {cy} 0 0 0 1 0 0 0 0 1"
    (folder / "info.txt").write_text(
        f"m_versionNumber = 4\nm_depthShift = 2000\nm_calibrationDepthIntrinsic = {matrix}\n"
    )
    (frame, *_) = read_capture(folder).frames
    assert (frame.intrinsics.fx, frame.intrinsics.cx, frame.intrinsics.cy) == (f, cx, cy)
    assert frame.load_depth_m().max() == pytest.approx(captures.depth_m(captures.poses()[0]).max() / 2, abs=1e-3)


def test_without_a_file_of_the_camera_it_is_a_kinect_and_that_is_said(tmp_path: Path) -> None:
    folder = captures.write_7scenes(tmp_path)
    (folder / "camera-intrinsics.txt").unlink()
    capture = read_capture(folder)
    assert capture.frames[0].intrinsics.fx == pytest.approx(585 * captures.WIDTH / 640)
    assert "a Kinect's were taken" in capture.warnings[0]


def test_without_pose_files_the_frames_have_no_poses(tmp_path: Path) -> None:
    folder = captures.write_7scenes(tmp_path)
    for path in folder.rglob("*.pose.txt"):
        path.unlink()
    assert [frame.camera_to_world for frame in read_capture(folder).frames] == [None] * 4


def test_a_pose_is_no_point_cloud(tmp_path: Path) -> None:
    """Pictures with pose files, and no depth: they are photos."""
    folder = captures.write_7scenes(tmp_path)
    for path in folder.rglob("*.depth.png"):
        path.unlink()
    capture = read_capture(folder)
    assert (capture.kind, len(capture.photos)) == ("photos", 4)


@pytest.mark.parametrize("words", ["1 0 0", "a b c d\n" * 4, "1 0 0 0\n" * 5])
def test_what_is_no_matrix_is_named(words: str, tmp_path: Path) -> None:
    folder = captures.write_7scenes(tmp_path)
    (folder / "seq-01/frame-000001.pose.txt").write_text(words)
    with pytest.raises(CaptureError) as caught:
        read_capture(folder)
    assert (caught.value.code, caught.value.file) == ("CAPTURE_UNREADABLE", "seq-01/frame-000001.pose.txt")


def test_the_largest_value_is_no_depth(tmp_path: Path) -> None:
    (frame, *_) = read_capture(captures.write_7scenes(tmp_path)).frames
    assert np.array_equal(frame.load_depth_m() > 0, captures.depth_m(captures.poses()[0]) > 0)
