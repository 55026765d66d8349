"""Colours at vertices as glTF has them: linear light in 16 bits, since 8 would band in the shadows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from services.edge.arrays import Bytes
from services.edge.srgb import to_linear

_KEPT = 0.8  # of the way to where the next colour begins: reading back gives the same


def rgba16(rgb: Bytes, light: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """(V,4) linear light and alpha 1 in 16 bits: RGB alone would not fill whole words."""
    rgba = np.full((len(rgb), 4), 65535, dtype="<u2")
    rgba[:, :3] = light[rgb]
    return rgba


def _shortest() -> NDArray[np.uint16]:
    """(256,) for every sRGB code the number that ends in the most zeros of those that mean it: bytes of zeros take no
    space, and 8 bits of linear light would band in the shadows."""
    own = to_linear(np.arange(256, dtype=np.uint8)) * 65535.0
    half = _KEPT / 2 * np.diff(own)
    low, high = own.copy(), own.copy()
    low[1:] -= half
    high[:-1] += half
    chosen = own.round().astype(np.uint16)
    for zeros in range(1, 16):
        step = float(1 << zeros)
        number = np.round(own / step) * step
        means = (number >= low) & (number <= np.minimum(high, 65535))
        chosen[means] = number[means]
    return chosen


TRUE = np.rint(to_linear(np.arange(256, dtype=np.uint8)) * 65535.0).astype(np.uint16)
SHORT = _shortest()
