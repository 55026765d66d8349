"""Compute the similarity of two pictures at each pixel: zero-mean normalised cross-correlation (ZNCC) of small windows.

With E the mean over a window, r the reference and s the other picture warped to it:

    ZNCC = (E[rs] − E[r]E[s]) / sqrt((var r + ε)(var s + ε)),   ε = the variance of the sensor's noise

It is independent of exposure. Because of ε plain walls, which have only noise, score near 0 and not at random.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from capture2vr.edge.arrays import Bytes, Floats

WINDOW = 7
"""Side of the windows in pixels: 5 is noisier, 9 makes thin objects wider."""
NOISE = 0.5
"""Standard deviation of the noise in grey levels (of 255): a phone's in daylight, after downscaling. With 1, which dark
and smooth surfaces hardly exceed, 63 instead of 67 % of a dark plush toy's pixels darker than 20 have depth, and of an
unglazed pot in a rendered walk 65 instead of 67 %, of which 5.3 instead of 5.2 % are wrong; .3 gains 1 % more."""


@dataclass(frozen=True, slots=True)
class Windows:
    """The reference's terms of the correlation: (H,W) float32 picture, window means, and 1/sqrt(var + ε)."""

    grey: Floats
    mean: Floats
    inverse: Floats

    @classmethod
    def of(cls, grey: Bytes) -> Windows:
        values = grey.astype(np.float32)
        mean = _box(values)
        return cls(values, mean, _inverse(_box(values * values) - mean * mean))

    def zncc(self, other: Floats) -> Floats:
        """Return the ZNCC (H,W) float32 in [-1,1] with the picture `other` (H,W) float32, warped to the reference."""
        mean = _box(other)
        score = _box(self.grey * other)
        score -= self.mean * mean
        score *= self.inverse
        score *= _inverse(_box(other * other) - mean * mean)
        return score


class BestTwo:
    """Mean of the two best scores of several sources per pixel: an occlusion in some of the sources does not matter.

    With one source it is that source's score."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self._first: Floats = np.full(shape, -1, np.float32)
        self._second = self._first.copy()
        self._sources = 0

    def add(self, score: Floats) -> None:
        """Add the scores (H,W) of one source."""
        np.maximum(self._second, np.minimum(self._first, score), out=self._second)
        np.maximum(self._first, score, out=self._first)
        self._sources += 1

    def mean(self) -> Floats:
        """Return the mean of the two best scores (H,W)."""
        return self._first if self._sources < 2 else (self._first + self._second) / 2


_BOX = np.full(WINDOW, 1 / WINDOW, np.float32)


def _box(values: Floats) -> Floats:
    """Box filter: means over windows."""
    # OpenCV's own box filter sums in float64, and takes half as long again.
    return np.asarray(cv2.sepFilter2D(values, cv2.CV_32F, _BOX, _BOX, borderType=cv2.BORDER_REFLECT))


def _inverse(variance: Floats) -> Floats:
    """Return 1/sqrt(var + ε)."""
    return np.asarray(cv2.pow(np.maximum(variance, 0) + np.float32(NOISE**2), -0.5), np.float32)
