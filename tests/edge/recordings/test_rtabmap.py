"""RTAB-Map's exports: poses of the camera or of the body that carries it, in every kind of table, by number or time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.read_capture import read_capture
from tests.support import captures

IDS = (1, 4, 5, 9, 10)
# A body whose X is ahead, Y to the left and Z up carries the camera 10 cm in front and 30 cm above.
LOCAL = np.array([[0.0, 0, 1, 0.1], [-1, 0, 0, 0], [0, -1, 0, 0.3], [0, 0, 0, 1]])
POSES = captures.poses(len(IDS), up="z")
TIME = 1600000000.5


def rows(kind: str, poses: list[np.ndarray]) -> str:
    """A table of poses: raw, timed, with numbers as RTAB-Map writes them, or bare."""
    if kind == "raw":
        return "\n".join(" ".join(map(repr, pose[:3].ravel().tolist())) for pose in poses)
    lines = []
    for number, pose in zip(IDS, poses, strict=True):
        words = [*pose[:3, 3], *captures.quaternion(pose[:3, :3])]
        words = words if kind == "bare" else [TIME + number, *words]
        lines.append(" ".join(f"{word:.9f}" for word in words) + (f" {number}" if kind == "numbered" else ""))
    head = "#timestamp x y z qx qy qz qw" + (" id" if kind == "numbered" else "")
    return "\n".join([head, *lines])


def yaml(*, carried: bool) -> str:
    fx, fy, cx, cy = captures.colour_camera()
    side = captures.COLOUR_SCALE
    local = ", ".join(map(str, LOCAL[:3].ravel()))
    text = f"""%YAML:1.0
---
camera_name: "device"
image_width: {captures.WIDTH * side}
image_height: {captures.HEIGHT * side}
camera_matrix:
   rows: 3
   cols: 3
   data: [ {fx}, 0., {cx}, 0.,
       {fy}, {cy}, 0., 0., 1. ]
distortion_coefficients:
   rows: 1
   cols: 5
   data: [ 0., 0., 0., 0., 0. ]
"""
    return text + (f"local_transform:\n   rows: 3\n   cols: 4\n   data: [ {local} ]\n" if carried else "")


def write(
    folder: Path,
    kind: str,
    *,
    of_body: bool,
    carried: bool = True,
    prefix: str = "",
    stem: Callable[[int], str] = str,
    own: bool = True,
) -> Path:
    for index, (number, pose) in enumerate(zip(IDS, POSES, strict=True)):
        captures.save_png(folder / f"{prefix}depth/{stem(number)}.png", captures.steps(captures.depth_m(pose)))
        captures.save_jpg(folder / f"{prefix}rgb/{stem(number)}.jpg", captures.picture(index))
        if own:
            (folder / f"{prefix}calib").mkdir(exist_ok=True)
            (folder / f"{prefix}calib/{stem(number)}.yaml").write_text(yaml(carried=carried))
    if not own:
        (folder / "calibration.yaml").write_text(yaml(carried=carried))
    poses = [pose @ np.linalg.inv(LOCAL) if of_body else pose for pose in POSES]
    (folder / f"{prefix}poses.txt").write_text(rows(kind, poses) + "\n")
    return folder


def assert_placed(capture: Capture) -> None:
    assert (capture.kind, capture.format, capture.scale_confidence) == ("rgbd", "rtabmap", "metric")
    assert capture.warnings == ()
    assert len(capture.frames) == len(IDS)
    for index, (frame, pose) in enumerate(zip(capture.frames, POSES, strict=True)):
        assert frame.camera_to_world is not None
        np.testing.assert_allclose(frame.camera_to_world, pose, atol=1e-6)
        assert frame.intrinsics.fx == pytest.approx(captures.FOCAL)
        assert frame.intrinsics.cx == pytest.approx(captures.CX)
        assert frame.load_rgb is not None
        assert abs(int(frame.load_rgb()[10, 10, 1]) - 40 * index) < 8


@pytest.mark.parametrize("kind", ["raw", "timed", "numbered", "bare"])
@pytest.mark.parametrize("of_body", [True, False])
def test_every_table_of_poses_is_read(tmp_path: Path, kind: str, of_body: bool) -> None:
    capture = read_capture(write(tmp_path, kind, of_body=of_body))
    assert_placed(capture)
    assert capture.up is not None
    assert capture.up.tolist() == [0, 0, 1]


def test_pictures_may_be_named_by_their_times(tmp_path: Path) -> None:
    folder = write(tmp_path, "timed", of_body=True, stem=lambda number: f"{TIME + number:.6f}")
    text = (folder / "poses.txt").read_text().splitlines()
    (folder / "poses.txt").write_text("\n".join([text[0], *reversed(text[1:])]))
    assert_placed(read_capture(folder))


def test_folders_may_have_the_name_of_the_export(tmp_path: Path) -> None:
    assert_placed(read_capture(write(tmp_path, "numbered", of_body=False, prefix="rtabmap_")))


def test_one_calibration_is_that_of_all_frames(tmp_path: Path) -> None:
    assert_placed(read_capture(write(tmp_path, "numbered", of_body=True, own=False)))


def test_poses_without_a_body_are_those_of_the_camera(tmp_path: Path) -> None:
    capture = read_capture(write(tmp_path, "raw", of_body=False, carried=False))
    assert_placed(capture)
    assert capture.up is None


def test_depth_images_without_a_pose_are_told(tmp_path: Path) -> None:
    folder = write(tmp_path, "numbered", of_body=True)
    lines = (folder / "poses.txt").read_text().splitlines()
    (folder / "poses.txt").write_text("\n".join(lines[:-1]))
    capture = read_capture(folder)
    assert len(capture.frames) == 4
    assert capture.warnings == ("1 of 5 depth images have no pose in poses.txt",)


def test_poses_of_other_frames_are_not_used_and_that_is_told(tmp_path: Path) -> None:
    folder = write(tmp_path, "raw", of_body=True)
    lines = (folder / "poses.txt").read_text().splitlines()
    (folder / "poses.txt").write_text("\n".join(lines[:-1]))
    capture = read_capture(folder)
    assert [frame.camera_to_world for frame in capture.frames] == [None] * 5
    assert capture.warnings[0].startswith("poses.txt was not used: its 4 poses")


@pytest.mark.parametrize(
    ("text", "code"), [("", "CAPTURE_NO_POSES"), ("1 2 3\n" * 5, "CAPTURE_UNREADABLE"), ("a b\n", "CAPTURE_UNREADABLE")]
)
def test_a_broken_table_is_named(tmp_path: Path, text: str, code: str) -> None:
    folder = write(tmp_path, "raw", of_body=True)
    (folder / "poses.txt").write_text(text)
    with pytest.raises(CaptureError) as caught:
        read_capture(folder)
    assert (caught.value.code, caught.value.file) == (code, "poses.txt")


def test_a_broken_calibration_is_named(tmp_path: Path) -> None:
    folder = write(tmp_path, "raw", of_body=True)
    (folder / "calib/1.yaml").write_text(yaml(carried=True).replace("0., 0., 1. ]", "0., 1. ]"))
    with pytest.raises(CaptureError) as caught:
        read_capture(folder)
    assert (caught.value.code, caught.value.file) == ("CAPTURE_UNREADABLE", "calib/1.yaml")
