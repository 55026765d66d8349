"""Vertex colours for glTF: linear light in 16 bits, because 8 bits would show bands in the shadows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from capture2vr.edge.arrays import Bytes
from capture2vr.edge.srgb import to_linear

_TOLERANCE = 0.8  # of the distance to where the next colour begins: rounding keeps the same sRGB byte


def rgba16(rgb: Bytes, light: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Convert sRGB (V,3) to (V,4) uint16 linear light with alpha 1; RGB alone would not fill whole 32-bit words.

    light (256,)  linear light of every sRGB byte: `TRUE` or `SHORT`
    """
    rgba = np.full((len(rgb), 4), 65535, dtype="<u2")
    rgba[:, :3] = light[rgb]
    return rgba


def _shortest() -> NDArray[np.uint16]:
    """(256,) uint16 linear light of every sRGB byte, rounded to as many zero bits at the end as still read back as the
    same byte: zero bytes compress to nothing."""
    own = to_linear(np.arange(256, dtype=np.uint8)) * 65535.0
    half = _TOLERANCE / 2 * np.diff(own)
    low, high = own.copy(), own.copy()
    low[1:] -= half
    high[:-1] += half
    chosen = own.round().astype(np.uint16)
    for zeros in range(1, 16):
        step = float(1 << zeros)
        number = np.round(own / step) * step
        same = (number >= low) & (number <= np.minimum(high, 65535))
        chosen[same] = number[same]
    return chosen


TRUE = np.rint(to_linear(np.arange(256, dtype=np.uint8)) * 65535.0).astype(np.uint16)
"""(256,) linear light of every sRGB byte, exact to 16 bits."""
SHORT = _shortest()
"""(256,) the same, rounded so that it compresses well."""
