"""Record3D's export of EXR and JPEG: the files are written here by OpenEXR's description, the depth is known."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from capture2vr.edge.capture.exr import decode_exr, decode_exr_colours
from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.read_capture import read_capture
from capture2vr.edge.srgb import to_linear
from tests.support.photos.exr_files import exr

W, H = 48, 37  # the last block of 16 lines is shorter
DEPTH = (1.5 + 0.01 * np.arange(H)[:, None] + 0.003 * np.arange(W)).astype(np.float32)


@pytest.mark.parametrize("compression", [0, 1, 2, 3])
@pytest.mark.parametrize("kind", ["<f4", "<f2"])
@pytest.mark.parametrize("turned", [False, True])
def test_lines_are_read(compression: int, kind: str, turned: bool) -> None:
    data = exr({"R": DEPTH.astype(kind)}, compression, top=5, turned=turned)
    np.testing.assert_array_equal(decode_exr(data, "a.exr"), DEPTH.astype(kind).astype(np.float32))


def test_depth_is_the_red_channel_of_several() -> None:
    noise = np.random.default_rng(0).random((H, W)).astype(np.float32)
    data = exr({"A": np.ones((H, W), "<f2"), "B": noise, "G": noise, "R": DEPTH})
    np.testing.assert_array_equal(decode_exr(data, "a.exr"), DEPTH)


def test_noise_is_stored_as_it_is() -> None:
    noise = np.random.default_rng(0).integers(0, 2**32, (H, W), dtype=np.uint32).view("<f4")
    np.testing.assert_array_equal(decode_exr(exr({"Z": noise}), "a.exr").view(np.uint32), noise.view(np.uint32))


CODES = np.arange(W * H * 3, dtype=np.uint8).reshape(H, W, 3)


@pytest.mark.parametrize("compression", [0, 1, 2, 3])
@pytest.mark.parametrize("kind", ["<f4", "<f2"])
def test_colours_are_linear_light(compression: int, kind: str) -> None:
    light = to_linear(CODES).astype(kind)
    data = exr({"A": light[..., 0], **{name: light[..., at] for at, name in enumerate("RGB")}}, compression)
    np.testing.assert_array_equal(decode_exr_colours(data, "a.exr"), CODES)


def test_light_of_a_high_range_is_white_and_none_is_black() -> None:
    light = np.full((2, 2), 0.5, np.float32)
    light[0] = [7e4, np.inf]
    light[1] = [-1, np.nan]
    rgb = decode_exr_colours(exr({"Y": light}), "a.exr")
    np.testing.assert_array_equal(rgb, np.repeat([[[255], [255]], [[0], [0]]], 3, axis=2))


GOOD = exr({"R": DEPTH})
BROKEN = {
    "cut off": (GOOD[:-20], "IMAGE_UNREADABLE"),
    "cut off in its header": (GOOD[:60], "IMAGE_UNREADABLE"),
    "a damaged block": (GOOD[:-40] + b"\xff" * 40, "IMAGE_UNREADABLE"),
    "RLE that ends early": (exr({"R": 0 * DEPTH}, 1)[:-2] + b"\1\0", "IMAGE_UNREADABLE"),
    "PIZ": (exr({"R": DEPTH}, 4), "IMAGE_UNREADABLE"),
    "tiles": (exr({"R": DEPTH}, version=2 | 0x200), "IMAGE_UNREADABLE"),
    "no channel": (exr({"R": DEPTH}).replace(b"R\0\x02", b"\0\0\x02"), "IMAGE_UNREADABLE"),
    "a channel of another type": (exr({"R": DEPTH}).replace(b"R\0\x02", b"R\0\x09"), "IMAGE_UNREADABLE"),
    "many lines": (GOOD.replace(struct.pack("<i", H - 1), struct.pack("<i", 2_000_000)), "IMAGE_UNREADABLE"),
    "too many pixels": (GOOD.replace(struct.pack("<i", H - 1), struct.pack("<i", 2**31 - 2)), "IMAGE_TOO_LARGE"),
    "a wrong end": (GOOD.replace(struct.pack("<i", H - 1), struct.pack("<i", -5)), "IMAGE_UNREADABLE"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_exr_is_refused(case: str) -> None:
    data, code = BROKEN[case]
    with pytest.raises(CaptureError) as caught:
        decode_exr(data, "a.exr")
    assert (caught.value.code, caught.value.file) == (code, "a.exr")


# ---- the recording ----


def recording(root: Path, frames: int = 4) -> Path:
    """Three cameras in a row, as Record3D writes them: with K of the picture, which has twice the depth's pixels."""
    folder = root / "EXR_RGBD"
    for part in ("rgb", "depth"):
        (folder / part).mkdir(parents=True)
    for index in range(frames):
        cv2.imwrite(str(folder / "rgb" / f"{index}.jpg"), np.full((2 * H, 2 * W, 3), 40 * index, np.uint8))
        (folder / "depth" / f"{index}.exr").write_bytes(exr({"R": DEPTH + np.float32(0.1 * index)}))
    poses = [[0, 0, 0, 1, 0.1 * index, 0, 0] for index in range(frames)]
    meta = {"w": 2 * W, "h": 2 * H, "fps": 30, "K": [100, 0, 0, 0, 101, 0, 47.5, 36.5, 1], "poses": poses}
    (folder / "metadata.json").write_text(json.dumps(meta))
    return root


def read(root: Path) -> Capture:
    return read_capture(root)


def test_depth_colours_poses_and_camera_are_read(tmp_path: Path) -> None:
    capture = read(recording(tmp_path))
    assert (capture.kind, capture.format, capture.scale_confidence) == ("rgbd", "record3d", "metric")
    assert len(capture.frames) == 4
    assert capture.warnings == ()
    frame = capture.frames[2]
    np.testing.assert_allclose(frame.load_depth_m(), DEPTH + np.float32(0.2), rtol=1e-6)
    assert frame.intrinsics.fx == pytest.approx(50)
    assert frame.intrinsics.fy == pytest.approx(50.5)
    assert frame.camera_to_world is not None
    np.testing.assert_allclose(frame.camera_to_world[:3, 3], [0.2, 0, 0], atol=1e-12)
    np.testing.assert_allclose(np.diag(frame.camera_to_world), [1, -1, -1, 1], atol=1e-12)
    assert frame.load_rgb is not None
    assert abs(int(frame.load_rgb()[5, 5, 0]) - 80) <= 2


def test_a_recording_without_poses_is_refused(tmp_path: Path) -> None:
    folder = recording(tmp_path) / "EXR_RGBD"
    meta = json.loads((folder / "metadata.json").read_text()) | {"poses": []}
    (folder / "metadata.json").write_text(json.dumps(meta))
    with pytest.raises(CaptureError) as caught:
        read(tmp_path)
    assert (caught.value.code, caught.value.file) == ("CAPTURE_NO_POSES", "metadata.json")


def test_an_exr_that_is_not_read_is_named(tmp_path: Path) -> None:
    for path in (recording(tmp_path) / "EXR_RGBD" / "depth").iterdir():
        path.write_bytes(exr({"R": DEPTH}, 4))
    with pytest.raises(CaptureError, match="PIZ") as caught:
        read(tmp_path)
    assert caught.value.file == "depth/0.exr"
    assert caught.value.hints
