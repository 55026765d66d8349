"""The layouts of ARKitScenes and Replica: what may be missing, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from capture2vr.edge.errors import CaptureError
from capture2vr.edge.read_capture import read_capture
from tests.support import captures

NO_SIZE = '{"camera": {"w": 0, "h": 0, "fx": 1, "fy": 1, "cx": 0, "cy": 0, "scale": 1}}'


def code_of(folder: Path) -> tuple[str, str | None]:
    with pytest.raises(CaptureError) as caught:
        read_capture(folder)
    return caught.value.code, caught.value.file


def test_arkitscenes_takes_the_depth_images_that_have_a_pose(tmp_path: Path) -> None:
    capture = read_capture(captures.write_arkitscenes(tmp_path))
    assert [frame.name[-10:] for frame in capture.frames] == ["00.000.png", "00.100.png", "00.200.png", "00.300.png"]


def test_arkitscenes_without_colours_and_confidence_has_depth(tmp_path: Path) -> None:
    folder = captures.write_arkitscenes(tmp_path)
    for name in ("lowres_wide", "confidence"):
        for path in (folder / name).iterdir():
            path.unlink()
    frames = read_capture(folder).frames
    assert [(frame.load_rgb, frame.load_confidence) for frame in frames] == [(None, None)] * 4


def test_arkitscenes_without_a_trajectory_is_refused(tmp_path: Path) -> None:
    folder = captures.write_arkitscenes(tmp_path)
    (folder / "lowres_wide.traj").write_text("")
    assert code_of(folder) == ("CAPTURE_NO_POSES", "lowres_wide.traj")
    (folder / "lowres_wide.traj").unlink()
    assert code_of(folder) == ("CAPTURE_NO_POSES", "lowres_depth")


def test_a_scene_of_replica_comes_without_the_camera_of_all(tmp_path: Path) -> None:
    folder = captures.write_replica(tmp_path)
    (folder / "cam_params.json").unlink()
    assert code_of(folder) == ("CAPTURE_BAD_INTRINSICS", "results/depth000000.png")
    for index, pose in enumerate(captures.poses()):
        large = captures.steps(captures.depth_m(pose), 6553.5).repeat(15, axis=0)[:680].repeat(19, axis=1)[:, :1200]
        captures.save_png(folder / f"results/depth{index:06}.png", large)
        (folder / f"results/frame{index:06}.jpg").unlink()
    assert read_capture(folder).frames[0].intrinsics.cx == 599.5


@pytest.mark.parametrize(
    ("kind", "file", "content", "code"),
    [
        ("arkitscenes", "lowres_wide.traj", "100.0 0 0 0 0 0\n", "CAPTURE_UNREADABLE"),
        ("arkitscenes", "lowres_wide.traj", "5.0 0 0 0 0 0 0\n", "CAPTURE_NO_POSES"),
        ("arkitscenes", "lowres_wide.traj", "100.0 nan 0 0 0 0 0\n", "CAPTURE_BAD_POSE"),
        ("arkitscenes", "lowres_wide_intrinsics/41069021_100.000.pincam", "0 0 60 60 30 25", "CAPTURE_UNREADABLE"),
        ("arkitscenes", "lowres_wide_intrinsics/41069021_100.000.pincam", "64 48 60", "CAPTURE_UNREADABLE"),
        ("arkitscenes", "lowres_depth/41069021_now.png", "", "CAPTURE_UNREADABLE"),
        ("replica", "traj.txt", "\n", "CAPTURE_NO_POSES"),
        ("replica", "traj.txt", "1 0 0 0\n", "CAPTURE_UNREADABLE"),
        ("replica", "traj.txt", "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n", "CAPTURE_COUNT_MISMATCH"),
        ("replica", "cam_params.json", "{}", "CAPTURE_UNREADABLE"),
        ("replica", "cam_params.json", NO_SIZE, "CAPTURE_UNREADABLE"),
    ],
)
def test_what_is_broken_has_its_name(kind: str, file: str, content: str, code: str, tmp_path: Path) -> None:
    folder = captures.RGBD[kind](tmp_path)
    (folder / file).write_text(content)
    assert code_of(folder)[0] == code
