"""Posed depth of every app: the sphere recorded is the sphere read, whatever axes and units the app has."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.films.video import VideoFrames
from capture2vr.edge.read_capture import read_capture
from tests.support import captures

_HALF_STEP_M = 0.0008  # half a millimetre along a ray that leaves the axis by up to 35 degrees, and rounding

WITHOUT_CONFIDENCE = ("open3d", "tum", "nerfstudio", "7scenes", "scannet", "replica")
WITHOUT_GRAVITY = ("open3d", "nerfstudio", "7scenes", "scannet", "replica", "arkitscenes")

Writer = Callable[[Path], Path]


@pytest.fixture(params=captures.RGBD, scope="module")
def recording(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Capture]:
    folder = tmp_path_factory.mktemp("recording")
    return request.param, read_capture(captures.RGBD[request.param](folder))


def test_every_back_projected_point_lies_on_the_sphere(recording: tuple[str, Capture]) -> None:
    _, capture = recording
    assert len(capture.frames) == 4
    for frame in capture.frames:
        points = captures.back_project(frame)
        assert len(points) > 300
        assert np.abs(np.linalg.norm(points - captures.CENTRE, axis=1) - captures.RADIUS_M).max() < _HALF_STEP_M


def test_what_is_said_about_the_world(recording: tuple[str, Capture]) -> None:
    name, capture = recording
    assert capture.kind == "rgbd"
    assert capture.format == {"r3d": "record3d"}.get(name, name)
    assert (capture.scale_confidence, capture.metres_per_unit, capture.warnings) == ("metric", 1.0, ())
    expected = {"tum": [0, 0, 1], **dict.fromkeys(WITHOUT_GRAVITY)}.get(name, [0, 1, 0])
    assert (None if capture.up is None else capture.up.tolist()) == expected


def test_poses_are_exact_rotations(recording: tuple[str, Capture]) -> None:
    for frame in recording[1].frames:
        rotation = frame.camera_to_world[:3, :3]
        assert frame.camera_to_world.dtype == np.float64
        assert np.abs(rotation @ rotation.T - np.eye(3)).max() < 1e-12
        assert np.linalg.det(rotation) > 0


def test_images_have_their_types_and_ranges(recording: tuple[str, Capture]) -> None:
    name, capture = recording
    for index, frame in enumerate(capture.frames):
        depth_m = frame.load_depth_m()
        assert (depth_m.dtype, depth_m.shape) == (np.float32, (captures.HEIGHT, captures.WIDTH))
        if frame.load_confidence is not None:
            confidence = frame.load_confidence()
            assert (confidence.dtype, confidence.shape) == (np.float32, depth_m.shape)
            assert confidence[depth_m > 0].min() == 1.0
            assert confidence[depth_m == 0].max(initial=0) == 0.0
        assert (frame.load_confidence is None) == (name in WITHOUT_CONFIDENCE)
        if name != "3dscannerapp" or index % 2 == 0:
            assert frame.load_rgb is not None
            assert_is_picture(frame.load_rgb(), index + (name == "stray"))
        else:
            assert frame.load_rgb is None


def assert_is_picture(rgb: np.ndarray, index: int) -> None:
    """Within what JPEG and MPEG-4 lose."""
    assert rgb.dtype == np.uint8
    assert rgb.shape == captures.picture(index).shape
    assert np.abs(rgb.astype(int) - captures.picture(index)).mean() < 6


def test_an_archive_folder_around_the_recording_is_stepped_into(tmp_path: Path) -> None:
    captures.write_open3d(tmp_path / "scan")
    assert len(read_capture(tmp_path).frames) == 4


def test_video_frames_come_in_any_order(tmp_path: Path) -> None:
    captures.write_video(tmp_path / "v.mp4", [captures.picture(index) for index in range(5)])
    video = VideoFrames(tmp_path / "v.mp4", "v.mp4")
    for index in (3, 0, 1, 4, 2):
        assert_is_picture(video.rgb(index), index)
    with pytest.raises(CaptureError, match="ends before frame 5") as caught:
        video.rgb(5)
    assert caught.value.code == "IMAGE_UNREADABLE"


def test_depth_scale_of_the_camera_file_wins(tmp_path: Path) -> None:
    folder = captures.write_open3d(tmp_path)
    camera = json.loads((folder / "camera.json").read_text())
    (folder / "camera.json").write_text(json.dumps(camera | {"depth_scale": 2000}))
    halved = read_capture(folder).frames[0].load_depth_m()
    assert halved.max() == pytest.approx(captures.depth_m(captures.poses()[0]).max() / 2, abs=1e-3)


def test_nerfstudio_takes_the_angle_of_view_and_frames_their_own_focal_length(tmp_path: Path) -> None:
    folder = captures.write_nerfstudio(tmp_path)
    tree = json.loads((folder / "transforms.json").read_text())
    focal = tree.pop("fl_x")
    tree.pop("fl_y")
    tree["camera_angle_x"] = 2 * np.arctan(tree["w"] / 2 / focal)
    tree["frames"][1]["fl_x"] = 2 * focal
    (folder / "transforms.json").write_text(json.dumps(tree))
    first, second, *_ = read_capture(folder).frames
    assert first.intrinsics.fx == pytest.approx(captures.FOCAL)
    assert first.intrinsics.fy == pytest.approx(captures.FOCAL)
    assert second.intrinsics.fx == pytest.approx(2 * captures.FOCAL)


STEP_M = 10 / 65_535  # metres: NeRFCapture's script has 10 m as the largest value of 16 bits


@pytest.mark.parametrize(
    ("top", "frame"),
    [
        ({"integer_depth_scale": STEP_M}, {}),
        ({}, {"integer_depth_scale": STEP_M}),
        ({"integer_depth_scale": 1.0}, {"integer_depth_scale": STEP_M}),
        ({"integer_depth_scale": 1.0}, {"depth_unit_scale_factor": STEP_M}),
    ],
)
def test_instant_ngps_unit_of_depth(top: dict[str, float], frame: dict[str, float], tmp_path: Path) -> None:
    folder = captures.write_nerfstudio(tmp_path)
    tree = json.loads((folder / "transforms.json").read_text()) | top
    for index, (each, pose) in enumerate(zip(tree["frames"], captures.poses(), strict=True)):
        captures.save_png(folder / f"depth/{index}.png", captures.steps(captures.depth_m(pose), 1 / STEP_M))
        each |= {"depth_path": each.pop("depth_file_path"), **frame}
    (folder / "transforms.json").write_text(json.dumps(tree))
    capture = read_capture(folder)
    assert (capture.kind, len(capture.frames), capture.warnings) == ("rgbd", 4, ())
    for read in capture.frames:
        off = np.linalg.norm(captures.back_project(read) - captures.CENTRE, axis=1) - captures.RADIUS_M
        assert np.abs(off).max() < _HALF_STEP_M


def previews(folder: Path) -> Path:
    """The capture with depth of 8 bits, as NeRFCapture's: from black at the camera to white at a metre."""
    for index, pose in enumerate(captures.poses()):
        grey = np.clip(captures.depth_m(pose) * 255, 0, 255).astype(np.uint8)
        captures.save_png(folder / f"depth/{index}.png", grey)
    return folder


def test_photos_are_taken_where_depth_is_a_preview(tmp_path: Path) -> None:
    folder = previews(captures.write_nerfstudio(tmp_path))
    capture = read_capture(folder)
    assert (capture.kind, capture.format, capture.scale_confidence) == ("photos", "nerfstudio", "unknown")
    assert [photo.name for photo in capture.photos] == [f"images/{index}.jpg" for index in range(4)]
    assert np.stack([photo.camera_to_world for photo in capture.photos]) == pytest.approx(np.stack(captures.poses()))
    (warning,) = capture.warnings
    assert warning.startswith("depth/0.png: has 8 bits per pixel")


def test_previews_of_depth_alone_are_refused(tmp_path: Path) -> None:
    folder = previews(captures.write_nerfstudio(tmp_path))
    shutil.rmtree(folder / "images")
    with pytest.raises(CaptureError, match="8 bits per pixel") as caught:
        read_capture(folder)
    assert (caught.value.code, caught.value.file) == ("IMAGE_UNREADABLE", "depth/0.png")


def test_a_broken_depth_image_is_no_preview(tmp_path: Path) -> None:
    """The first of twelve: it alone is left out."""
    folder = captures.write_nerfstudio(tmp_path)
    tree = json.loads((folder / "transforms.json").read_text())
    tree["frames"] = [dict(tree["frames"][0], depth_file_path="depth/broken.png"), *tree["frames"] * 3]
    (folder / "transforms.json").write_text(json.dumps(tree))
    (folder / "depth/broken.png").write_bytes(b"no picture")
    capture = read_capture(folder)
    assert (capture.kind, len(capture.frames)) == ("rgbd", 12)


def test_lens_distortion_is_taken_out_of_depth(tmp_path: Path) -> None:
    """Distorting the sphere's depth as the lens would, then reading it, gives the sphere back."""
    folder = captures.write_nerfstudio(tmp_path)
    k1 = 0.08
    for index, pose in enumerate(captures.poses()):
        v, u = np.mgrid[: captures.HEIGHT, : captures.WIDTH]
        x, y = (u - captures.CX) / captures.FOCAL, (v - captures.CY) / captures.FOCAL
        for _ in range(20):  # the inverse of x_d = x (1 + k1 r^2), as a fixed point
            r2 = x**2 + y**2
            x, y = (
                (u - captures.CX) / captures.FOCAL / (1 + k1 * r2),
                (v - captures.CY) / captures.FOCAL / (1 + k1 * r2),
            )
        seen = captures.depth_m(pose)
        columns = np.clip(np.rint(x * captures.FOCAL + captures.CX).astype(int), 0, captures.WIDTH - 1)
        rows = np.clip(np.rint(y * captures.FOCAL + captures.CY).astype(int), 0, captures.HEIGHT - 1)
        captures.save_png(folder / f"depth/{index}.png", captures.steps(seen[rows, columns]))
    tree = json.loads((folder / "transforms.json").read_text())
    (folder / "transforms.json").write_text(json.dumps(tree | {"k1": k1, "camera_model": "OPENCV"}))
    frame = read_capture(folder).frames[0]
    points = captures.back_project(frame)
    off = np.abs(np.linalg.norm(points - captures.CENTRE, axis=1) - captures.RADIUS_M)
    assert np.median(off) < 0.004  # depth is looked up to the nearest pixel, twice: 17 mm apart on the sphere
    assert frame.load_rgb is not None
    assert frame.load_rgb().shape == captures.picture(0).shape


def test_confidence_of_another_size_is_fitted(tmp_path: Path) -> None:
    folder = captures.write_polycam(tmp_path)
    for path in (folder / "keyframes/confidence").iterdir():
        captures.save_png(path, np.array([[0, 255]], np.uint8))
    frame = read_capture(folder).frames[0]
    assert frame.load_confidence is not None
    confidence = frame.load_confidence()
    assert confidence.shape == (captures.HEIGHT, captures.WIDTH)
    assert (confidence == (np.arange(captures.WIDTH) >= captures.WIDTH / 2)).all()


@pytest.mark.parametrize("damage", [b"no picture", captures.jpg_bytes(captures.picture(0)[:100])])
def test_a_frame_whose_picture_does_not_fit_keeps_its_depth(damage: bytes, tmp_path: Path) -> None:
    folder = captures.write_open3d(tmp_path)
    (folder / "color/00002.jpg").write_bytes(damage)
    capture = read_capture(folder)
    assert [frame.load_rgb is None for frame in capture.frames] == [False, False, True, False]
    assert "color/00002.jpg" in capture.warnings[0]


def test_some_missing_depth_is_a_warning(tmp_path: Path) -> None:
    folder = captures.write_nerfstudio(tmp_path)
    (folder / "depth/2.png").unlink()
    capture = read_capture(folder)
    assert len(capture.frames) == 3
    assert "depth/2.png" in capture.warnings[0]


def test_a_few_broken_frames_are_skipped_with_a_warning(tmp_path: Path) -> None:
    """Ten per cent: one of twelve."""
    folder = captures.write_nerfstudio(tmp_path)
    tree = json.loads((folder / "transforms.json").read_text())
    tree["frames"] = tree["frames"] * 3
    broken = dict(tree["frames"][5], transform_matrix=np.full((4, 4), np.nan).tolist())
    tree["frames"][5] = broken
    (folder / "transforms.json").write_text(json.dumps(tree))
    capture = read_capture(folder)
    assert len(capture.frames) == 11
    assert "not finite" in capture.warnings[0]


def test_depth16_before_tracking_is_skipped(tmp_path: Path) -> None:
    folder = captures.write_depth16(tmp_path)
    lines = (folder / "poses.csv").read_text().splitlines()
    fields = lines[1].split(",")
    lines[1] = ",".join([fields[0], "0.0", "-0.0", "0.0", *fields[4:]])
    (folder / "poses.csv").write_text("\n".join(lines))
    capture = read_capture(folder)
    assert len(capture.frames) == 3
    assert "before tracking" in capture.warnings[0]


def test_stray_without_video_has_no_colours(tmp_path: Path) -> None:
    folder = captures.write_stray(tmp_path)
    (folder / "rgb.mp4").unlink()
    k = np.loadtxt(folder / "camera_matrix.csv", delimiter=",")
    scale = 1920 / (captures.WIDTH * captures.COLOUR_SCALE)
    np.savetxt(folder / "camera_matrix.csv", np.diag([scale, scale, 1]) @ k, delimiter=",")
    capture = read_capture(folder)
    assert capture.frames[0].load_rgb is None
    assert "rgb.mp4" in capture.warnings[0]
    assert (
        np.abs(np.linalg.norm(captures.back_project(capture.frames[0]) - captures.CENTRE, axis=1) - 0.25).max() < 0.003
    )


@pytest.mark.parametrize("name", ["stray", "polycam", "3dscannerapp", "depth16"])
def test_depth_without_poses_has_its_name(name: str, tmp_path: Path) -> None:
    folder = captures.RGBD[name](tmp_path)
    for pattern in ("odometry.csv", "keyframes/corrected_cameras", "frame_*.json", "poses.csv"):
        for path in folder.glob(pattern):
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    with pytest.raises(CaptureError) as caught:
        read_capture(folder)
    assert caught.value.code == "CAPTURE_NO_POSES"
    assert caught.value.hints
