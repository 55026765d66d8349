"""Convert the colours of every file format to (N,3) uint8 sRGB: their range is told by what most of them are."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture2vr.edge.arrays import Bytes, Floats, Ints
from capture2vr.sentences.sentence import say

_TOP = 0.98
"""Quantile of the stored values that decides their range: some writers store single ones beyond it."""
_LOOKED_AT = 100_000
"""Points, evenly spread, by which the range is told."""


def rgb8(values: NDArray[Any], scale: float | None = None) -> Bytes:
    """Convert bytes, 16-bit integers, or floats in [0,1] or [0,255] to (N,3) uint8; non-finite values become 0.

    scale: the factor to bytes; None: `scale_of` the values
    """
    if values.dtype == np.uint8:
        return np.ascontiguousarray(values, dtype=np.uint8)
    scale = scale_of(values) if scale is None else scale
    floats = np.nan_to_num(values.astype(np.float64), nan=0.0, posinf=0.0, neginf=0.0)
    return np.clip(np.rint(floats * scale), 0, 255).astype(np.uint8)


def scale_of(values: NDArray[Any]) -> float:
    """Factor from stored colours (N,3) to bytes. What most of them reach decides, because writers disagree: LAS should
    have 16 bits and often has 8. Greys beyond bytes are a scanner's intensities, in a range of its own."""
    some = _some(values)
    if not len(some):
        return 1.0
    top = float(np.quantile(some.max(axis=1), _TOP))
    if np.issubdtype(values.dtype, np.floating) and top <= 1.0:
        return 255.0
    if top <= 255.0:
        return 1.0
    return 255.0 / top if _are_grey(some) else 255.0 / 65535.0


def read_colours(
    stored: NDArray[Any] | None, intensity: NDArray[Any] | None = None
) -> tuple[Bytes | None, tuple[str, ...]]:
    """Return colours (N,3) uint8 of colours as a file has them, else of its intensities (N,), and what is to be said.

    None where there are none, or they were never filled: all are black.
    """
    notes: tuple[str, ...] = ()
    if stored is not None and len(stored) and not _are_filled(stored):
        stored, notes = None, (say("colours_never_filled"),)
    if stored is None and intensity is not None and _are_filled(intensity):
        stored = _grey(intensity)
    if stored is None:
        return None, notes
    if stored.dtype == np.uint16 and _are_grey(_some(stored)):
        notes = (*notes, say("colours_are_intensities"))
    return rgb8(stored), notes


def _are_filled(values: NDArray[Any]) -> bool:
    """Return whether any of the values is a number other than 0; one that is, is soon found."""
    return bool(np.nan_to_num(values[: len(values) // 100 + 1]).any() or np.nan_to_num(values).any())


def _grey(intensity: NDArray[Any]) -> NDArray[Any]:
    """Return intensities (N,) as stored colours (N,3): 16 bits, of which what most of them reach is white."""
    known = np.nan_to_num(intensity.astype(np.float64), nan=0.0, posinf=0.0, neginf=0.0)
    top = float(np.quantile(known[:: max(1, len(known) // _LOOKED_AT)], _TOP)) if len(known) else 0.0
    shades = np.clip(known / top, 0, 1) if top > 0 else np.zeros(len(known))
    return np.repeat((65535 * shades)[:, None], 3, axis=1).astype(np.uint16)


def _some(values: NDArray[Any]) -> Floats:
    some = np.asarray(values[:: max(1, len(values) // _LOOKED_AT)], np.float64)
    return np.nan_to_num(some, nan=0.0, posinf=0.0, neginf=0.0)


def _are_grey(some: Floats) -> bool:
    return bool((some == some[:, :1]).all())


def unpack_rgb(packed: Ints) -> Bytes:
    """Unpack PCL's 0x00RRGGBB words (N,) to (N,3) uint8."""
    words = packed.astype(np.uint32)
    return np.stack([(words >> shift) & 0xFF for shift in (16, 8, 0)], axis=1).astype(np.uint8)
