"""The layout of NeRF's synthetic scenes: photos of all splits with Blender's cameras, whose alpha is the mask."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from capture2vr.edge.arrays import no_tick
from capture2vr.edge.capture.masks import with_masks
from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.read_capture import read_capture

ANGLE = 0.6911112070083618  # of the published scenes
SIDE = 80
COUNTS = {"train": 4, "val": 2, "test": 3}
# Blender's camera looks along its -Z with Y up; this one stands at x = 4, looks to the origin, and has Z up.
POSE = [[0.0, 0.0, 1.0, 4.0], [1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]


def scene(root: Path, **changed: Any) -> Path:
    rgba = np.zeros((SIDE, SIDE, 4), np.uint8)
    rgba[20:60, 30:50] = (10, 20, 200, 255)
    for split, count in COUNTS.items():
        (root / split).mkdir(parents=True)
        frames = []
        for index in range(count):
            cv2.imwrite(str(root / split / f"r_{index}.png"), rgba)
            frames.append({"file_path": f"./{split}/r_{index}", "rotation": 0.01, "transform_matrix": POSE})
        (root / f"transforms_{split}.json").write_text(
            json.dumps({"camera_angle_x": ANGLE, "frames": frames} | changed)
        )
    cv2.imwrite(str(root / "test" / "r_0_depth_0001.png"), rgba)
    cv2.imwrite(str(root / "test" / "r_0_normal_0001.png"), rgba)
    return root


def read(folder: Path) -> Capture:
    return read_capture(folder)


def test_all_splits_are_read_with_their_cameras(tmp_path: Path) -> None:
    capture = read(scene(tmp_path / "lego"))
    assert (capture.kind, capture.format, capture.scale_confidence) == ("photos", "blender", "unknown")
    assert len(capture.photos) == 9
    assert capture.warnings == ()
    assert capture.up is not None
    assert capture.up.tolist() == [0, 0, 1]
    for photo in capture.photos:
        camera, pose = photo.intrinsics, photo.camera_to_world
        assert camera is not None
        assert pose is not None
        assert camera.fx == pytest.approx(SIDE / 2 / math.tan(ANGLE / 2))
        assert (camera.cx, camera.cy) == (SIDE / 2 - 0.5, SIDE / 2 - 0.5)
        np.testing.assert_allclose(pose[:3, 3], [4, 0, 0], atol=1e-12)
        np.testing.assert_allclose(pose[:3, 2], [-1, 0, 0], atol=1e-12)  # it looks to the origin
        np.testing.assert_allclose(pose[:3, 1], [0, 0, -1], atol=1e-12)  # and Y of the picture is down


def test_what_is_transparent_is_masked(tmp_path: Path) -> None:
    photos, warnings = with_masks(read(scene(tmp_path)).photos, no_tick)
    assert warnings == ()
    for photo in photos:
        assert photo.mask is not None
        assert photo.mask.sum() == 40 * 20
        assert photo.mask[20:60, 30:50].all()


def test_a_split_without_its_pictures_is_told(tmp_path: Path) -> None:
    folder = scene(tmp_path)
    shutil.rmtree(folder / "test")
    (folder / "val" / "r_1.png").unlink()
    capture = read(folder)
    assert len(capture.photos) == 5
    assert any("4 images are missing" in warning or "./test/r_0" in warning for warning in capture.warnings)
    assert any("val/r_1" in warning for warning in capture.warnings)


def test_the_training_split_alone_is_a_capture(tmp_path: Path) -> None:
    folder = scene(tmp_path)
    for split in ("val", "test"):
        shutil.rmtree(folder / split)
        (folder / f"transforms_{split}.json").unlink()
    assert len(read(folder).photos) == 4


def test_a_picture_of_two_splits_is_one(tmp_path: Path) -> None:
    folder = scene(tmp_path)
    (folder / "transforms_val.json").write_bytes((folder / "transforms_train.json").read_bytes())
    assert len(read(folder).photos) == 4 + 3


def test_other_programs_say_nothing_of_up(tmp_path: Path) -> None:
    folder = scene(tmp_path)
    for path in folder.glob("*.json"):
        path.write_text(path.read_text().replace('"rotation"', '"time"'))
    assert read(folder).up is None


@pytest.mark.parametrize(
    ("changed", "code"),
    [
        ({"frames": []}, "CAPTURE_EMPTY"),
        ({"frames": [{"file_path": "./train/no", "transform_matrix": POSE}]}, "CAPTURE_COUNT_MISMATCH"),
        ({"frames": [{"file_path": "../../etc/r_0", "transform_matrix": POSE}]}, "CAPTURE_COUNT_MISMATCH"),
        ({"frames": "many"}, "CAPTURE_UNREADABLE"),
        ({"camera_angle_x": 7}, "CAPTURE_BAD_INTRINSICS"),
    ],
)
def test_a_broken_file_is_named(tmp_path: Path, changed: dict[str, Any], code: str) -> None:
    with pytest.raises(CaptureError) as caught:
        read(scene(tmp_path, **changed))
    assert caught.value.code == code
    assert (caught.value.file or "").startswith("transforms_t")
