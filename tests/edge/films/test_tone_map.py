"""Films of high dynamic range: colours that are known come back in sRGB."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pytest

from capture2vr.edge.films.video import VideoFrames
from capture2vr.edge.srgb import to_linear

PQ, HLG, BT2020 = 16, 18, 9
COLOURS = np.array(
    [[200, 200, 200], [128, 128, 128], [40, 40, 40], [180, 60, 40], [40, 150, 70], [60, 80, 170]], np.uint8
)
TO_BT709 = np.array([[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]])


def hlg_signal(light: np.ndarray) -> np.ndarray:
    """Signal of light in units of white, by BT.2100's inverse OOTF and its OETF."""
    shown = light * 203 / 1000
    luma = shown @ [0.2627, 0.6780, 0.0593]
    scene = shown * np.maximum(luma, 1e-9)[..., None] ** (1 / 1.2 - 1)
    bright = 0.17883277 * np.log(np.maximum(12 * scene - 0.28466892, 1e-9)) + 0.55991073
    return np.where(scene <= 1 / 12, np.sqrt(3 * scene), bright)


def pq_signal(light: np.ndarray) -> np.ndarray:
    power = (np.maximum(light, 0) * 203 / 10_000) ** 0.1593017578125
    return ((0.8359375 + 18.8515625 * power) / (1 + 18.6875 * power)) ** 78.84375


def film(path: Path, light: np.ndarray, transfer: int) -> Path:
    """A lossless film of 10 bits, of patches of this light (N,3) in BT.2020."""
    signal = (hlg_signal if transfer == HLG else pq_signal)(light).clip(0, 1)
    patches = np.repeat(np.repeat((signal * 65_535).round().astype(np.uint16)[None], 32, 0), 32, 1)
    with av.open(path, "w") as container:
        stream = container.add_stream("ffv1", rate=10)
        stream.width, stream.height, stream.pix_fmt = patches.shape[1], 32, "yuv444p10le"
        context = stream.codec_context
        context.color_trc, context.color_primaries, context.colorspace = transfer, BT2020, BT2020
        for stamp in range(3):
            frame = av.VideoFrame.from_ndarray(patches, format="rgb48le")
            frame.color_trc, frame.color_primaries = transfer, BT2020
            frame = frame.reformat(format="yuv444p10le", dst_colorspace=BT2020)
            frame.pts = stamp
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def in_bt2020(rgb: np.ndarray) -> np.ndarray:
    return to_linear(rgb).astype(float) @ np.linalg.inv(TO_BT709).T


@pytest.mark.parametrize("transfer", [HLG, PQ])
@pytest.mark.parametrize("scaled", [False, True])
def test_colours_come_back(transfer: int, scaled: bool, tmp_path: Path) -> None:
    path = film(tmp_path / "a.mkv", in_bt2020(COLOURS), transfer)
    frames = VideoFrames(path, "a.mkv")
    size = (16 * len(COLOURS), 16)
    shown = frames.at(0, size) if scaled else frames.rgb(1)
    middles = shown[len(shown) // 2, len(shown) // 2 :: len(shown)]
    np.testing.assert_allclose(middles.astype(int), COLOURS, atol=3)


@pytest.mark.parametrize("transfer", [HLG, PQ])
def test_highlights_are_rolled_off_and_keep_their_hue(transfer: int, tmp_path: Path) -> None:
    light = np.array([1.0, 2.0, 4.0])[:, None] * in_bt2020(np.array([[255, 128, 90]], np.uint8))
    shown = VideoFrames(film(tmp_path / "a.mkv", light, transfer), "a.mkv").rgb(0)[16, 16::32].astype(int)
    assert (np.diff(shown[:, 0]) >= 0).all()
    assert shown[0, 0] > 225
    ratio = to_linear(shown.astype(np.uint8))
    np.testing.assert_allclose(ratio[:, 1] / ratio[:, 0], (to_linear(np.uint8(128)) / 1.0), atol=0.03)
