"""Cameras for other trainers: COLMAP's own library and our readers find them where they were."""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
import trimesh

from capture2vr.edge.asset.capture_files import capture_files
from capture2vr.edge.convert.camera_files import colmap_zip
from capture2vr.edge.convert.convert_bundle import convert
from capture2vr.edge.read_capture import read_capture
from tests.edge.asset.test_capture_files import CAMERA, points
from tests.support import captures
from tests.support.downloadable import TO_ASSET, downloadable, written

CAMERAS = (CAMERA, replace(CAMERA, name="b\nc.jpg", distortion=(0.1, 0.0, 0.0, 0.0, 0.5)))


@pytest.fixture(scope="module")
def files() -> dict[str, bytes]:
    return capture_files(replace(points(300), cameras=CAMERAS), TO_ASSET)


def unzipped(files: dict[str, bytes], name: str, folder: Path) -> Path:
    whole = downloadable()
    bundle = written(replace(whole, files={**whole.files, **files}), folder / "bundle")
    data = convert(bundle, name, "sheet")
    assert data == convert(bundle, name, "sheet")
    with zipfile.ZipFile(io.BytesIO(data)) as package:
        package.extractall(folder)
    return folder


def test_colmap_reads_its_text(files: dict[str, bytes], tmp_path: Path) -> None:
    model = pycolmap.Reconstruction(unzipped(files, "colmap", tmp_path) / "sparse" / "0")
    told = json.loads(files["cameras.json"])["cameras"]
    assert sorted(image.name for image in model.images.values()) == ["a.jpg", "b_c.jpg"]
    for image, expected in zip(sorted(model.images.values(), key=lambda each: each.name), told, strict=True):
        camera = model.cameras[image.camera_id]
        pose = np.array(expected["camera_to_world"])
        world_to_camera = image.cam_from_world().matrix()
        np.testing.assert_allclose(world_to_camera[:, :3], pose[:, :3].T, atol=1e-6)
        np.testing.assert_allclose(image.projection_center(), pose[:, 3], atol=1e-6)
        middle = camera.img_from_cam(np.array([[0.0, 0.0, 1.0]]))
        np.testing.assert_allclose(middle, [[30.5, 20.5]])  # COLMAP's pixel centres are at one half
    assert {camera.model.name for camera in model.cameras.values()} == {"OPENCV", "FULL_OPENCV"}
    assert len(model.points3D) == 300
    first = model.points3D[1]
    assert first.color.dtype == np.uint8


def test_our_own_reader_takes_the_colmap_model_back(files: dict[str, bytes], tmp_path: Path) -> None:
    """The second camera has a k3, so its model is FULL_OPENCV."""
    folder = unzipped(files, "colmap", tmp_path / "out")
    for name in ("a.jpg", "b_c.jpg"):
        captures.save_jpg(folder / "images" / name, np.zeros((40, 60, 3), np.uint8))
    capture = read_capture(folder)
    assert (capture.format, [photo.name for photo in capture.photos]) == ("colmap", ["images/a.jpg", "images/b_c.jpg"])
    told = json.loads(files["cameras.json"])["cameras"]
    for photo, expected in zip(capture.photos, told, strict=True):
        assert photo.distortion == pytest.approx(expected["distortion"])
        assert photo.camera_to_world is not None
        np.testing.assert_allclose(photo.camera_to_world[:3], expected["camera_to_world"], atol=1e-6)
        assert photo.intrinsics is not None
        fields = ("fx", "fy", "cx", "cy")
        assert [getattr(photo.intrinsics, field) for field in fields] == pytest.approx(expected["camera"])


def test_transforms_have_nerfstudios_axes_and_the_points_beside_them(files: dict[str, bytes], tmp_path: Path) -> None:
    folder = unzipped(files, "transforms", tmp_path)
    document = json.loads((folder / "transforms.json").read_text())
    first, _ = document["frames"]
    assert (first["file_path"], first["w"], first["h"], first["cx"], first["k1"]) == ("images/a.jpg", 60, 40, 30.5, 0.1)
    pose = np.array(json.loads(files["cameras.json"])["cameras"][0]["camera_to_world"])
    matrix = np.array(first["transform_matrix"])
    np.testing.assert_allclose(matrix[:3, 3], pose[:, 3])
    np.testing.assert_allclose(-matrix[:3, 2], pose[:, 2], err_msg="a camera of OpenGL looks along -Z")
    cloud = trimesh.load(folder / document["ply_file_path"])
    assert cloud.vertices.shape == (300, 3)


def test_damaged_files_are_told(files: dict[str, bytes]) -> None:
    good = files["cameras.json"]
    for cameras, laz in ((b"", files["points.laz"]), (b'{"cameras": [{}]}', files["points.laz"]), (good, b"LASF")):
        with pytest.raises(ValueError, match="cannot be read"):
            colmap_zip(cameras, laz)
