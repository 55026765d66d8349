"""Convert frames of films to sRGB, also those of high dynamic range, as iPhones film them: HLG or PQ, in BT.2020.

Taken for sRGB, such a film is dull. Light is relative to the white of a sheet of paper, 203 cd/m² (ITU-R BT.2408),
which becomes sRGB's white; what is brighter is rolled off. Curves: ITU-R BT.2100-2, tables 4 and 5.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.srgb import to_srgb

_PQ, _HLG, _BT2020 = 16, 18, 9  # numbers of transfer curves and primaries in ISO/IEC 23091-2
_WHITE = 203.0  # cd/m²
_HLG_PEAK, _HLG_GAMMA = 1_000.0, 1.2  # of the display that HLG's system gamma is for
_LUMA = np.array([0.2627, 0.6780, 0.0593], np.float32)  # of BT.2020
_TO_BT709 = np.array([[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]], np.float32)
_KNEE = 0.8  # light of the largest channel from which on it is rolled off
_LINES = 256  # of a frame that are converted together: their arrays take 25 MB in a film of 8K


def is_hdr(frame: Any) -> bool:
    """Return whether a decoded frame has a curve of high dynamic range."""
    return frame.color_trc in (_PQ, _HLG)


def srgb_of(frame: Any, size: tuple[int, int] | None = None) -> Bytes:
    """Convert a decoded frame to (H,W,3) uint8 sRGB; size: (width, height) to scale it to."""
    width, height = size or (frame.width, frame.height)
    form = "rgb48le" if is_hdr(frame) else "rgb24"
    pixels = frame.reformat(width, height, format=form, interpolation="AREA").to_ndarray()
    if form == "rgb24":
        return np.ascontiguousarray(pixels)
    return np.concatenate([_tone_mapped(pixels[at : at + _LINES], frame) for at in range(0, len(pixels), _LINES)])


def _tone_mapped(codes: Any, frame: Any) -> Bytes:
    """Convert codes (h,w,3) of 16 bits to sRGB."""
    light = _curve(frame.color_trc)[codes]
    if frame.color_trc == _HLG:
        light *= (light @ _LUMA)[..., None] ** (_HLG_GAMMA - 1) * (_HLG_PEAK / _WHITE)
    if frame.color_primaries == _BT2020:
        light = np.maximum(light @ _TO_BT709.T, 0)
    largest = light.max(axis=2, keepdims=True)
    over = np.maximum(largest - _KNEE, 0) / (1 - _KNEE)
    rolled = np.minimum(largest, _KNEE) + (1 - _KNEE) * (1 - np.exp(-over))
    return to_srgb(light * (rolled / np.maximum(largest, 1e-6)))


@cache
def _curve(transfer: int) -> Floats:
    """Light (65536,) float32 of every code: of HLG the scene's in [0,1], of PQ the display's in units of white."""
    signal = np.arange(2**16) / (2**16 - 1)
    if transfer == _HLG:
        a, b, c = 0.17883277, 0.28466892, 0.55991073
        scene: Floats = np.where(signal <= 0.5, signal**2 / 3, (np.exp((signal - c) / a) + b) / 12).astype(np.float32)
        return scene
    m1, m2, c1, c2, c3 = 2610 / 16384, 2523 / 32, 3424 / 4096, 2413 / 128, 2392 / 128
    root = signal ** (1 / m2)
    shown: Floats = (10_000 / _WHITE * (np.maximum(root - c1, 0) / (c2 - c3 * root)) ** (1 / m1)).astype(np.float32)
    return shown
