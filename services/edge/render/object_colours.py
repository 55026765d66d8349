"""Tell an object from its background by colour, where their colours differ: pixel by pixel, at a photo's full size.

Depth marks the pixels that show the object. Some of them are background, matched across an outline: as much of the
background's histogram is taken out of the object's as explains what it has of the background's own colours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats, Ints
from capture2vr.edge.parallel import in_threads

MOST = 4.0
"""Largest evidence of a pixel, either way: one photo must not decide alone."""
SURE = 2.5
"""Evidence from which on a pixel is the object's: those of an outline have both colours, and evidence of more than 0
from a quarter of the object's on."""

_BINS = 32  # of each axis of CIELAB
_BLUR = 0.7  # of the histograms, in bins: the standard deviation of a Gaussian
_PIXEL_BLUR = 0.6  # of the evidence, in pixels
_FAR = 0.03  # of the longer side: farther from all points is background
_COMMON = 0.9  # share of the background's pixels whose colours are its common ones
_MARGIN = 1.5  # times the share of background that is found among the object's pixels is taken out of these
_MOST_OF_IT = 0.6  # share of background among the object's pixels from which on nothing is known of its colours
_FLOOR = 1e-6  # probability of a colour that was not seen
MOST_ALIKE = 0.15
"""Likeness of the two histograms from which on the colours alone do not tell object and background apart."""


@dataclass(frozen=True, slots=True)
class ObjectColours:
    """Logarithm (bins³,) of how much likelier each colour is on the object than on the background, within ± `MOST`."""

    evidence_of: Floats

    @classmethod
    def learn(
        cls, photos: Sequence[Bytes], at: Sequence[Floats], most_alike: float = MOST_ALIKE
    ) -> ObjectColours | None:
        """Learn the colours from photos (h,w,3) uint8 sRGB and the positions (N,2) of the object's points in each, in
        shares of its sides. None where object and background have the same colours: where the Bhattacharyya coefficient
        of their histograms is over `most_alike`.
        """
        on, off = np.zeros(_BINS**3), np.zeros(_BINS**3)
        for thing_in, ground_in in in_threads(lambda seen: _counts(*seen), list(zip(photos, at, strict=True))):
            on += thing_in
            off += ground_in
        if not on.any() or not off.any():
            return None
        thing, ground = _smooth(on), _smooth(off)
        mixed = _background_in(thing, ground)
        thing = np.maximum(thing - _MARGIN * mixed * ground, 0)
        if mixed > _MOST_OF_IT or not thing.any():
            return None
        thing /= thing.sum()
        if np.sqrt(thing * ground).sum() > most_alike:
            return None
        return cls(np.clip(np.log((thing + _FLOOR) / (ground + _FLOOR)), -MOST, MOST).astype(np.float32))

    def evidence(self, rgb: Bytes) -> Floats:
        """Return the evidence (h,w) float32 that each pixel of a photo (h,w,3) shows the object, within ± `MOST`."""
        import cv2

        return np.asarray(cv2.GaussianBlur(self.evidence_of[_bins(rgb)], (0, 0), _PIXEL_BLUR), np.float32)


def _counts(rgb: Bytes, places: Floats) -> tuple[Ints, Ints]:
    """Count (bins³,) a photo's pixels at the object's points, and of those around them, by colour."""
    away, colours = _away(rgb, places), _bins(rgb)
    on, around = colours[away == 0], colours[_is_around(away)]
    return np.bincount(on, minlength=_BINS**3), np.bincount(around, minlength=_BINS**3)


def _bins(rgb: Bytes) -> Ints:
    """Number (h,w) of each pixel's colour among the bins."""
    import cv2

    lightness, a, b = np.moveaxis(cv2.cvtColor(rgb, cv2.COLOR_RGB2LAB).astype(np.int64) * _BINS // 256, 2, 0)
    numbers: Ints = (lightness * _BINS + a) * _BINS + b
    return numbers


def _away(rgb: Bytes, places: Floats) -> Floats:
    """Distance (h,w) of each pixel from the next of the points (N,2), in pixels."""
    import cv2

    height, width = rgb.shape[:2]
    free = np.ones((height, width), np.uint8)
    column, row = (places * [width, height]).astype(np.int64).T
    free[row, column] = 0
    return np.asarray(cv2.distanceTransform(free, cv2.DIST_L2, 5))


def _is_around(away: Floats) -> Bools:
    """Mask (h,w) of the pixels far from all points, and not enclosed by them."""
    from scipy.ndimage import binary_fill_holes

    return np.asarray(~binary_fill_holes(away <= _FAR * max(away.shape)))


def _smooth(counts: Floats) -> Floats:
    from scipy.ndimage import gaussian_filter

    smooth = gaussian_filter(counts.reshape(_BINS, _BINS, _BINS), _BLUR, mode="nearest").ravel()
    shares: Floats = smooth / smooth.sum()
    return shares


def _background_in(thing: Floats, ground: Floats) -> float:
    """Share of the background's histogram in the object's: the median of their ratio over its common colours."""
    order = np.argsort(-ground)
    common = order[: np.searchsorted(np.cumsum(ground[order]), _COMMON) + 1]
    ratio = thing[common] / ground[common]
    order = np.argsort(ratio)
    weight = np.cumsum(ground[common][order])
    return float(ratio[order][np.searchsorted(weight, weight[-1] / 2)])
