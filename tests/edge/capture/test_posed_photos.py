"""Recordings of phones without a depth sensor: the app's poses and cameras, with its pictures as photos."""

from __future__ import annotations

import json
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.read_capture import read_capture
from tests.edge.films.test_film import HEIGHT, VIEWS, WIDTH, encode
from tests.support import captures

FRAMES = 40  # of the video


def polycam(root: Path) -> Path:
    folder = captures.write_polycam(root)
    for part in ("depth", "confidence"):
        shutil.rmtree(folder / "keyframes" / part)
    return folder


def polycam_uncorrected(root: Path) -> Path:
    folder = polycam(root)
    for part in ("cameras", "images"):
        (folder / f"keyframes/corrected_{part}").rename(folder / f"keyframes/{part}")
    return folder


def scanner3d(root: Path) -> Path:
    """All four frames have their pictures."""
    folder = captures.write_scanner3d(root)
    for path in [*folder.glob("depth_*"), *folder.glob("conf_*")]:
        path.unlink()
    for index in (1, 3):
        captures.save_jpg(folder / f"frame_{index:05}.jpg", captures.picture(index))
    return folder


def record3d(root: Path) -> Path:
    folder = captures.write_record3d(root)
    for path in [*folder.glob("rgbd/*.depth"), *folder.glob("rgbd/*.conf")]:
        path.unlink()
    return folder


def r3d(root: Path) -> Path:
    inside = record3d(root / "inside")
    archive = root / "capture.r3d"
    with zipfile.ZipFile(archive, "w") as target:
        for path in sorted(path for path in inside.rglob("*") if path.is_file()):
            target.write(path, path.relative_to(inside))
    return archive


def stray_poses() -> list[np.ndarray]:
    """One for each frame of the video."""
    return captures.poses(FRAMES)


def stray(root: Path) -> Path:
    root.mkdir(parents=True, exist_ok=True)
    rows = ["timestamp, frame, x, y, z, qx, qy, qz, qw"]
    for index, pose in enumerate(stray_poses()):
        words = [f"{word:.9f}" for word in (*pose[:3, 3], *captures.quaternion(pose[:3, :3]))]
        rows.append(", ".join([f"{index / 30:.4f}", f"{index:06}", *words]))
    (root / "odometry.csv").write_text("\n".join(rows) + "\n")
    (root / "camera_matrix.csv").write_text("300,0,160\n0,300,120\n0,0,1\n")
    encode(root / "rgb.mp4", VIEWS[:FRAMES])
    return root


APPS: dict[str, Callable[[Path], Path]] = {
    "polycam": polycam,
    "polycam, uncorrected": polycam_uncorrected,
    "3dscannerapp": scanner3d,
    "record3d": record3d,
    "record3d, zipped": r3d,
}


@pytest.mark.parametrize("app", APPS)
def test_photos_have_the_cameras_that_the_app_tells(app: str, tmp_path: Path) -> None:
    """A photo's pixel of the sphere's centre is where pose and lens put it, whatever axes the app has."""
    capture = read_capture(APPS[app](tmp_path))
    assert_metric(capture, app.split(",")[0])
    assert capture.warnings == ()
    fx, fy, cx, cy = captures.colour_camera()
    assert len(capture.photos) == 4
    for index, (photo, pose) in enumerate(zip(capture.photos, captures.poses(), strict=True)):
        np.testing.assert_allclose(photo.camera_to_world, pose, atol=1e-6)
        lens = photo.intrinsics
        assert lens is not None
        np.testing.assert_allclose([lens.fx, lens.fy, lens.cx, lens.cy], [fx, fy, cx, cy], atol=1e-3)
        assert (lens.width, lens.height) == photo.size == (256, 192)
        assert photo.distortion == (0.0,) * 5
        assert np.abs(photo.load().astype(int) - captures.picture(index)).mean() < 6
        assert photo.load(128).shape == (96, 128, 3)


def assert_metric(capture: Capture, kind: str) -> None:
    assert (capture.kind, capture.format, capture.scale_confidence, capture.metres_per_unit) == (
        "photos",
        kind,
        "metric",
        1.0,
    )
    assert capture.up is not None
    assert capture.up.tolist() == [0, 1, 0]


def test_a_stray_recording_has_the_key_frames_of_its_video(tmp_path: Path) -> None:
    capture = read_capture(stray(tmp_path))
    assert_metric(capture, "stray")
    assert 12 <= len(capture.photos) < FRAMES
    for photo in capture.photos:
        index = round(float(photo.name.split(" at ")[1].split()[0]) * 30)
        np.testing.assert_allclose(photo.camera_to_world, stray_poses()[index], atol=1e-6)
        assert photo.intrinsics is not None
        assert (photo.intrinsics.fx, photo.size) == (300, (WIDTH, HEIGHT))
        assert np.abs(photo.load().astype(int) - VIEWS[index]).mean() < 4


def remove(*names: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        for name in names:
            for path in folder.glob(name):
                path.unlink()

    return change


def edit(pattern: str, **values: object) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        for path in folder.glob(pattern):
            path.write_text(json.dumps(json.loads(path.read_text()) | values))

    return change


def odometry(change: Callable[[list[str]], list[str]]) -> Callable[[Path], None]:
    def spoil(folder: Path) -> None:
        path = folder / "odometry.csv"
        path.write_text("\n".join(change(path.read_text().splitlines())))

    return spoil


BAD: dict[str, tuple[Callable[[Path], Path], str, Callable[[Path], None]]] = {
    "Polycam without anything": (
        polycam,
        "CAPTURE_UNREADABLE",
        remove("keyframes/corrected_images/*"),
    ),
    "Polycam with half of its cameras": (
        polycam,
        "CAPTURE_COUNT_MISMATCH",
        remove("keyframes/corrected_cameras/*[01].json"),
    ),
    "Polycam's focal length 0": (polycam, "CAPTURE_BAD_INTRINSICS", edit("keyframes/*cameras/*.json", fx=0)),
    "Polycam mirrored": (
        polycam,
        "CAPTURE_BAD_POSE",
        edit("keyframes/*cameras/*.json", **dict.fromkeys(("t_00", "t_11"), 1), t_22=-1, t_01=0, t_02=0, t_10=0,
             t_12=0, t_20=0, t_21=0),
    ),
    "Polycam of another shape": (polycam, "CAPTURE_BAD_INTRINSICS", edit("keyframes/*cameras/*.json", width=999)),
    "3D Scanner App's NaN": (
        scanner3d,
        "CAPTURE_BAD_POSE",
        edit("frame_*.json", cameraPoseARFrame=[float("nan")] * 16),
    ),
    "3D Scanner App without words": (scanner3d, "CAPTURE_UNREADABLE", edit("frame_*.json", intrinsics="wide")),
    "Record3D with half of its poses": (record3d, "CAPTURE_COUNT_MISMATCH", edit("metadata", poses=[[0] * 7])),
    "Record3D without a lens": (record3d, "CAPTURE_BAD_INTRINSICS", edit("metadata", K=[0] * 9)),
    "Record3D without pictures": (record3d, "CAPTURE_COUNT_MISMATCH", remove("rgbd/*[1-3].jpg")),
    "Stray without its matrix": (stray, "CAPTURE_BAD_INTRINSICS", remove("camera_matrix.csv")),
    "Stray without half of its poses": (stray, "CAPTURE_BAD_POSE", odometry(lambda rows: rows[:20])),
    "Stray of nothing that moves": (
        stray,
        "CAPTURE_LOW_OVERLAP",
        lambda folder: encode(folder / "rgb.mp4", VIEWS[:1] * 60) and None,
    ),
    "Stray with a cut video": (
        stray,
        "CAPTURE_UNREADABLE",
        lambda folder: (folder / "rgb.mp4").write_bytes((folder / "rgb.mp4").read_bytes()[:5000]) and None,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_what_is_broken_has_its_code(name: str, tmp_path: Path) -> None:
    make, code, spoil = BAD[name]
    folder = make(tmp_path)
    spoil(folder)
    with pytest.raises(CaptureError) as caught:
        read_capture(folder)
    assert caught.value.code == code
    assert caught.value.hints


def test_one_lost_picture_is_a_verdict(tmp_path: Path) -> None:
    folder = scanner3d(tmp_path)
    (folder / "frame_00002.jpg").write_bytes(b"\xff\xd8 no picture")
    capture = read_capture(folder)
    assert [photo.name for photo in capture.photos] == [f"frame_0000{index}.jpg" for index in (0, 1, 3)]
    assert [(verdict.name, verdict.verdict) for verdict in capture.verdicts] == [("frame_00002.jpg", "unreadable")]


def test_one_lost_frame_of_a_video_is_a_warning(tmp_path: Path) -> None:
    folder = stray(tmp_path)
    used = len(read_capture(folder).photos)
    name = read_capture(folder).photos[3].name
    index = round(float(name.split(" at ")[1].split()[0]) * 30)
    odometry(lambda rows: [row for row in rows if f", {index:06}," not in row])(folder)
    capture = read_capture(folder)
    assert len(capture.photos) == used - 1
    assert f"{name}: is frame {index}, which has no row in odometry.csv" in capture.warnings[0]


def test_polycam_images_without_cameras_are_photos(tmp_path: Path) -> None:
    folder = polycam(tmp_path)
    shutil.rmtree(folder / "keyframes/corrected_cameras")
    capture = read_capture(folder)
    assert (capture.format, len(capture.photos), capture.scale_confidence) == ("photos", 4, "unknown")
    assert {photo.camera_to_world for photo in capture.photos} == {None}


def test_where_depth_exists_it_stays_the_way(tmp_path: Path) -> None:
    for index, app in enumerate(("polycam", "3dscannerapp", "record3d", "stray")):
        assert read_capture(captures.RGBD[app](tmp_path / str(index))).kind == "rgbd"
