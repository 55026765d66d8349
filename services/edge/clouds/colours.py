"""Convert the colours of every file format to (N,3) uint8 sRGB."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture2vr.edge.arrays import Bytes, Ints


def rgb8(values: NDArray[Any], scale: float | None = None) -> Bytes:
    """Convert bytes, 16-bit integers, or floats in [0,1] or [0,255] to (N,3) uint8; non-finite values become 0.

    scale: the factor to bytes; None: `scale_of` the largest value
    """
    if values.dtype == np.uint8:
        return np.ascontiguousarray(values, dtype=np.uint8)
    floats = np.nan_to_num(values.astype(np.float64), nan=0.0, posinf=0.0, neginf=0.0)
    scale = scale_of(float(floats.max(initial=0.0)), values.dtype) if scale is None else scale
    return np.clip(np.rint(floats * scale), 0, 255).astype(np.uint8)


def scale_of(top: float, kind: np.dtype[Any]) -> float:
    """Factor from stored colours to bytes. The largest value decides, because writers disagree: LAS should have 16 bits
    and often has 8."""
    unit_range = top <= 1.0 and np.issubdtype(kind, np.floating)
    return 255.0 if unit_range else 1.0 if top <= 255.0 else 255.0 / 65535.0


def unpack_rgb(packed: Ints) -> Bytes:
    """Unpack PCL's 0x00RRGGBB words (N,) to (N,3) uint8."""
    words = packed.astype(np.uint32)
    return np.stack([(words >> shift) & 0xFF for shift in (16, 8, 0)], axis=1).astype(np.uint8)
