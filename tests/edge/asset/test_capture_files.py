"""Points and cameras beside an asset: where the asset is, upright, bounded, the same every time."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from capture2vr.edge.asset import capture_files as module
from capture2vr.edge.asset.capture_files import capture_files
from capture2vr.edge.capture.nouns import PictureCamera
from capture2vr.edge.convert.capture_points import CapturePoints
from capture2vr.edge.points.nouns import Points
from capture2vr.order.download_formats import CAMERAS, POINTS
from tests.support.downloadable import TO_ASSET

CAMERA = PictureCamera(
    "a.jpg", (60, 40), (50.0, 51.0, 30.0, 20.0), (0.1, 0.0, 0.0, 0.0, 0.0), ((1, 0, 0, 1), (0, 0, -1, 2), (0, 1, 0, 3))
)


def points(count: int, size: float = 1.0) -> Points:
    rng = np.random.default_rng(0)
    xyz, rgb = size * rng.normal(size=(count, 3)), rng.integers(0, 256, (count, 3)).astype(np.uint8)
    return Points(xyz, rgb, np.ones(count, np.float32), 1.0, "metric", None)


@pytest.mark.parametrize("size", [1e-3, 1.0, 500.0])
def test_points_are_where_the_asset_is_with_z_up(size: float) -> None:
    given = points(500, size)
    files = capture_files(given, TO_ASSET)
    assert files.keys() == {POINTS}
    assert capture_files(given, TO_ASSET) == files
    found = CapturePoints.read(files[POINTS])
    x, y, z = (given.xyz @ TO_ASSET[:3, :3].T + TO_ASSET[:3, 3]).T
    np.testing.assert_allclose(found.xyz, np.stack([x, -z, y], axis=1), atol=1e-3 * size)
    np.testing.assert_array_equal(found.rgb, given.rgb)
    assert CapturePoints.read(capture_files(replace(given, rgb=None), TO_ASSET)[POINTS]).rgb is None


def test_points_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_POINTS", 200)
    found = CapturePoints.read(capture_files(points(5_000), TO_ASSET)[POINTS])
    assert 50 < len(found.xyz) <= 200


def test_a_camera_looks_at_the_same_points_as_in_the_capture() -> None:
    given = replace(points(100), cameras=(CAMERA,))
    files = capture_files(given, TO_ASSET)
    (told,) = json.loads(files[CAMERAS])["cameras"]
    assert (told["name"], told["size"], told["camera"][2]) == ("a.jpg", [60, 40], 30.0)
    pose = np.array(told["camera_to_world"])
    np.testing.assert_allclose(pose[:, :3] @ pose[:, :3].T, np.eye(3), atol=1e-8)
    assert np.linalg.det(pose[:, :3]) == pytest.approx(1)
    before = np.array(CAMERA.camera_to_world)
    in_capture = (given.xyz - before[:, 3]) @ before[:, :3]
    seen = (CapturePoints.read(files[POINTS]).xyz - pose[:, 3]) @ pose[:, :3]
    np.testing.assert_allclose(seen, 2 * in_capture, atol=1e-3, err_msg="the asset is twice as large")
