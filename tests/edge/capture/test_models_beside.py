"""A mesh beside photos, a video or a recording: what was read is told, and what was left out."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np

from capture2vr.edge.read_capture import read_capture
from tests.support import captures
from tests.support.clouds import sphere_points

BALL = sphere_points(300)


def add_mesh(folder: Path) -> None:
    rows = [f"v {x:.5f} {y:.5f} {z:.5f}" for x, y, z in BALL] + [f"f {n} {n + 1} {n + 2}" for n in range(1, 298)]
    (folder / "foo.obj").write_text("\n".join(rows))


def add_photos(folder: Path, count: int) -> None:
    for index in range(count):
        pixels = np.random.default_rng(index).integers(0, 256, (48, 64, 3), dtype=np.uint8)
        cv2.imwrite(str(folder / f"IMG_{index}.jpg"), pixels)


def test_of_a_mesh_beside_photos_both_are_told(tmp_path: Path) -> None:
    add_mesh(tmp_path)
    add_photos(tmp_path, 20)
    capture = read_capture(tmp_path)
    assert (capture.kind, capture.format) == ("points", "obj")
    assert any("foo.obj was used, and the 20 photos" in warning for warning in capture.warnings)


def test_of_a_mesh_beside_a_video_both_are_told(tmp_path: Path) -> None:
    add_mesh(tmp_path)
    film = cv2.VideoWriter(str(tmp_path / "walk.mp4"), cv2.VideoWriter_fourcc(*"mp4v"), 10, (64, 48))  # type: ignore[attr-defined]
    for _ in range(5):
        film.write(np.zeros((48, 64, 3), np.uint8))
    film.release()
    (warning,) = read_capture(tmp_path).warnings
    assert warning.startswith("foo.obj was used, and the video walk.mp4")


def test_of_a_mesh_beside_photos_with_cameras_both_are_told(tmp_path: Path) -> None:
    add_mesh(tmp_path)
    add_photos(tmp_path, 4)
    frames = [{"file_path": f"IMG_{index}.jpg", "transform_matrix": np.eye(4).tolist()} for index in range(4)]
    (tmp_path / "transforms.json").write_text(json.dumps({"camera_angle_x": 0.8, "frames": frames}))
    capture = read_capture(tmp_path)
    assert capture.kind == "photos"
    assert any("the photos were used, and no mesh beside them (foo.obj)" in warning for warning in capture.warnings)


def test_of_a_mesh_beside_depth_frames_both_are_told(tmp_path: Path) -> None:
    folder = captures.write_tum(tmp_path)
    add_mesh(folder)
    capture = read_capture(folder)
    assert capture.kind == "rgbd"
    assert any("the depth images were used" in warning and "foo.obj" in warning for warning in capture.warnings)
