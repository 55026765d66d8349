"""How alike two pictures are around each pixel: the zero-mean normalised cross-correlation (ZNCC) of small windows.

With E the mean over a window, r the reference and s the other picture brought into its place:

    ZNCC = (E[rs] − E[r]E[s]) / sqrt((var r + ε)(var s + ε)),   ε = the variance of the sensor's noise

It does not see exposure. ε makes plain walls, where only noise correlates, score near 0 instead of anything at all.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from services.edge.arrays import Bytes, Floats

WINDOW = 7
"""Pixels along a side: 5 is noisier, 9 widens thin things."""
NOISE = 1.0
"""Grey levels (of 255): a phone's noise in daylight after the picture was made smaller."""


@dataclass(frozen=True, slots=True)
class Windows:
    """The reference's part of the correlation: (H,W) float32 picture, window means, and 1/sqrt(var + ε)."""

    grey: Floats
    mean: Floats
    inverse: Floats

    @classmethod
    def of(cls, grey: Bytes) -> Windows:
        values = grey.astype(np.float32)
        mean = _box(values)
        return cls(values, mean, _inverse(_box(values * values) - mean * mean))

    def zncc(self, other: Floats) -> Floats:
        """(H,W) float32 in [-1,1] of the picture `other` (H,W) float32 that has been warped here."""
        mean = _box(other)
        spread = _inverse(_box(other * other) - mean * mean)
        return (_box(self.grey * other) - self.mean * mean) * self.inverse * spread


class BestTwo:
    """Mean of the two best scores of several sources, or the only one: a surface hidden from one still has two."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self._first: Floats = np.full(shape, -1, np.float32)
        self._second: Floats = np.full(shape, -1, np.float32)

    def add(self, score: Floats) -> None:
        np.maximum(self._second, np.minimum(self._first, score), out=self._second)
        np.maximum(self._first, score, out=self._first)

    def mean(self) -> Floats:
        return np.where(self._second > -1, (self._first + self._second) / 2, self._first)


def _box(values: Any) -> Floats:
    import cv2

    return np.asarray(cv2.boxFilter(values, cv2.CV_32F, (WINDOW, WINDOW), borderType=cv2.BORDER_REFLECT))


def _inverse(variance: Floats) -> Floats:
    return np.float32(1) / np.sqrt(np.maximum(variance, 0) + np.float32(NOISE**2))
