"""Convert sRGB bytes to linear light and back, so that averages of colours are averages of light."""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats

_CODES = np.arange(256) / 255.0
_LINEAR: Floats = np.where(_CODES <= 0.04045, _CODES / 12.92, ((_CODES + 0.055) / 1.055) ** 2.4).astype(np.float32)
"""(256,) linear light in [0,1] of every sRGB byte, IEC 61966-2-1."""
_BOUNDARIES: Floats = ((_LINEAR[1:] + _LINEAR[:-1]) / 2).astype(np.float32)
"""(255,) limits between neighbouring bytes, half-way in linear light: so a byte survives the round trip."""
_CELLS = 4096  # of the table: narrower than the darkest byte, 1/3295 wide, so that a cell has at most one limit
_FIRST = np.searchsorted(_BOUNDARIES, (np.arange(_CELLS + 1) / _CELLS).astype(np.float32)).astype(np.uint8)
"""Byte at the beginning of each cell of linear light; what lies past that byte's limit is the next one."""
_UPPER = np.append(_BOUNDARIES, np.float32(np.inf))
"""(256,) upper limit of each byte."""


def to_linear(rgb: Bytes) -> Floats:
    """Convert (...,3) uint8 sRGB to (...,3) float32 linear light in [0,1]."""
    linear: Floats = _LINEAR[rgb]
    return linear


def to_srgb(linear: Floats) -> Bytes:
    """Convert (...,3) linear light to (...,3) uint8 sRGB; values outside [0,1] are clipped."""
    light = np.asarray(linear, np.float32)
    # A table of cells: 20 times as fast as a binary search, with the same bytes.
    byte = _FIRST.take((np.clip(light, 0, 1) * np.float32(_CELLS)).astype(np.int16))
    return np.asarray(byte + (light > _UPPER.take(byte)), np.uint8)
