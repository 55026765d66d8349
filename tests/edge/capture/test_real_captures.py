"""Captures that somebody made: phones, scanners and modelling programs, read as they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from capture2vr.edge.capture.nouns import Cloud
from capture2vr.edge.clouds.sample_surface import SAMPLES
from capture2vr.edge.read_capture import read_capture
from tests.support import captures

pytestmark = pytest.mark.data


def cloud_of(path: Path) -> Cloud:
    capture = read_capture(path)
    assert capture.kind == "points"
    assert capture.cloud is not None
    assert np.isfinite(capture.cloud.xyz).all()
    return capture.cloud


def test_a_fused_fragment_with_colours_and_normals(data_dir: Path) -> None:
    cloud = cloud_of(data_dir / "cloud_room/fragment.pcd")
    assert cloud.xyz.shape == (113_662, 3)
    assert cloud.rgb is not None
    assert cloud.rgb.std() > 20
    assert cloud.normals is not None
    assert np.linalg.norm(cloud.normals, axis=1) == pytest.approx(1, abs=1e-3)


def test_a_coloured_mesh_in_a_ply(data_dir: Path) -> None:
    cloud = cloud_of(data_dir / "cloud_room/frag_115.ply")
    assert cloud.xyz.shape == (SAMPLES, 3)
    assert cloud.rgb is not None
    assert cloud.rgb.std() > 20


@pytest.mark.parametrize("name", ["dress", "tshirt_folded", "moebius", "open_surfaces/hemisphere.obj"])
def test_bare_meshes(name: str, data_dir: Path) -> None:
    cloud = cloud_of(data_dir / name)
    assert cloud.xyz.shape == (SAMPLES, 3)
    assert cloud.rgb is None


@pytest.mark.parametrize(
    ("name", "size_m"),
    [("car", (3.85, 1.30, 1.62)), ("milktruck", (4.87, 2.58, 2.79)), ("sunflower", (0.36, 0.58, 0.27))],
)
def test_gltf_scenes_stand_upright_in_metres_and_colour(
    name: str, size_m: tuple[float, float, float], data_dir: Path
) -> None:
    """Sizes of the scenes with their nodes' transforms, as glTF viewers show them; wheels stand on the floor."""
    capture = read_capture(data_dir / name)
    assert capture.scale_confidence == "metric"
    assert capture.up is not None
    assert capture.up.tolist() == [0, 1, 0]
    assert capture.cloud is not None
    assert np.ptp(capture.cloud.xyz, axis=0) == pytest.approx(size_m, abs=0.02)
    assert capture.cloud.xyz[:, 1].min() == pytest.approx(0, abs=0.01)
    assert capture.cloud.rgb is not None
    assert capture.cloud.rgb.std() > 20


def test_the_sunflower_is_yellow(data_dir: Path) -> None:
    rgb = cloud_of(data_dir / "sunflower").rgb
    assert rgb is not None
    red, green, blue = rgb.mean(axis=0)
    assert min(red, green) > 2 * blue


def test_frames_of_the_living_room_agree(data_dir: Path) -> None:
    """Five frames a few centimetres apart see the same walls: with a wrong axis or scale they would not."""
    capture = read_capture(data_dir / "rgbd_livingroom")
    assert (capture.format, len(capture.frames), capture.warnings) == ("open3d", 5, ())
    assert capture.up is None
    first, last = captures.back_project(capture.frames[0])[::31], captures.back_project(capture.frames[-1])
    gaps_m = cKDTree(last).query(first)[0]
    assert np.median(gaps_m) < 0.006


def test_a_phone_with_a_time_of_flight_sensor(data_dir: Path) -> None:
    """Recognised by its depth although a .ply lies beside; that cloud has the same depths and colours.

    The app makes it with a fixed focal length of 170 px and the centre at (120, 90), in the camera's frame; the pose
    file's projection says 178.8 px, so only depth, direction and colour can agree.
    """
    capture = read_capture(data_dir / "phone_tof")
    assert (capture.kind, capture.format, len(capture.frames)) == ("rgbd", "depth16", 1)
    (frame,) = capture.frames
    camera, depth_m = frame.intrinsics, frame.load_depth_m()
    assert (camera.width, camera.height) == (240, 180)
    assert camera.fx == pytest.approx(1.4902 * 240 / 2)
    table = np.loadtxt(data_dir / "phone_tof/00000012.ply", skiprows=10)
    u, v = np.rint(table[:, :2] / table[:, 2:3] * 170 + [120, 90]).astype(int).T
    assert np.count_nonzero(depth_m) == len(table)
    np.testing.assert_allclose(depth_m[v, u], table[:, 2], atol=1e-6)
    ours = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy], axis=1) * table[:, 2:3]
    assert np.abs(ours - table[:, :2] * 170 / camera.fx).max() < 0.006  # the centres differ by 0.7 px at 1.1 m
    assert frame.load_rgb is not None
    rgb = frame.load_rgb()
    assert rgb.shape == (1080, 1440, 3)
    np.testing.assert_array_equal(rgb[6 * v, 6 * u], table[:, 3:6])
    assert frame.load_confidence is not None
    assert 0.3 < frame.load_confidence()[depth_m > 0].mean() < 0.9


def test_photos_alone_are_read(data_dir: Path) -> None:
    capture = read_capture(data_dir / "photos_fruit/images")
    assert (capture.kind, capture.format, capture.scale_confidence) == ("photos", "photos", "unknown")
    assert [photo.name for photo in capture.photos] == [f"IMG_{number}.JPG" for number in range(4190, 4210)]
    assert {photo.size for photo in capture.photos} == {(600, 400)}
    assert len({photo.camera for photo in capture.photos}) == 1


@pytest.mark.slow
def test_a_mesh_beside_its_pictures_is_the_mesh(data_dir: Path) -> None:
    assert read_capture(data_dir / "photos_fruit").format == "obj"
