"""Key points of photos: OpenCV's SIFT with RootSIFT descriptors, found in a small picture, told in the stored one.

Relja Arandjelović, Andrew Zisserman, "Three things everyone should know to improve object retrieval", CVPR 2012:
the square root of a SIFT histogram compares better than the histogram.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np

from services.edge.arrays import Bools, Bytes, Floats, Tick, no_tick
from services.edge.capture.nouns import Photo
from services.edge.threads import in_threads


@dataclass(frozen=True, slots=True)
class Setting:
    """How thoroughly to look: longer side of the picture in pixels, most key points, SIFT's contrast threshold."""

    longest: int
    count: int
    contrast: float


FAST = Setting(800, 1500, 0.015)  # 50 phone photos: all placed, as exactly as from 1000 px and twice the key points
FINE = Setting(1600, 4096, 0.01)  # for photos that FAST leaves out: weak texture, wide steps

_EDGE = 10.0  # SIFT's own limit on how edge-like a key point may be
_SIGMA = 1.6  # pixels; SIFT's own
_OCTAVE_LAYERS = 3  # SIFT's own
_QUANTUM = 512.0  # of a descriptor's byte: the roots of a histogram that sums to 1 stay below 0.5


@dataclass(frozen=True, slots=True)
class Features:
    """xy (K,2) float32 pixels of the stored picture, pixel centres at integers; descriptors (K,128) uint8."""

    xy: Floats
    descriptors: Bytes


def find_features(photos: Sequence[Photo], setting: Setting, tick: Tick = no_tick) -> list[Features]:
    """The key points of each photo. Raises what `Photo.load` and `tick` raise."""
    return in_threads(partial(features_of, setting=setting), photos, tick)


def features_of(photo: Photo, setting: Setting) -> Features:
    grey = cv2.cvtColor(photo.load(setting.longest), cv2.COLOR_RGB2GRAY)
    # SIFT leaves out what is masked only after it has counted: with a mask all are found, and the best taken here.
    count = setting.count if photo.mask is None else 0
    # Without the precise upscaling every key point lies 0.25 pixels too far right and down.
    sift = cv2.SIFT.create(count, _OCTAVE_LAYERS, setting.contrast, _EDGE, _SIGMA, enable_precise_upscale=True)
    mask = None if photo.mask is None else sized(photo.mask, grey.shape).astype(np.uint8)
    points, histograms = sift.detectAndCompute(grey, mask)
    if not points:
        return Features(np.empty((0, 2), np.float32), np.empty((0, 128), np.uint8))
    if photo.mask is not None:
        best = np.argsort([-point.response for point in points], kind="stable")
        points, histograms = [points[index] for index in best], histograms[best]
    # SIFT keeps one point beyond the count where two score alike.
    xy = np.array([point.pt for point in points[: setting.count]])
    ratio = np.divide(photo.size, grey.shape[::-1])
    stored = ((xy + 0.5) * ratio - 0.5).astype(np.float32)
    return Features(stored, root_sift(np.asarray(histograms[: setting.count], np.float32)))


def sized(mask: Bools, shape: tuple[int, ...]) -> Bools:
    """The mask at (H,W)."""
    resized = cv2.resize(mask.astype(np.uint8), (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST)
    return np.asarray(resized, np.bool_)


def root_sift(histograms: Floats) -> Bytes:
    """(K,128) SIFT histograms -> their element-wise roots after normalising the sums, in 1/512."""
    total = np.maximum(histograms.sum(axis=1, keepdims=True), 1e-7)  # an empty histogram stays empty
    roots: Floats = np.rint(_QUANTUM * np.sqrt(histograms / total))
    return np.clip(roots, 0, 255).astype(np.uint8)


def pixel_of(photo: Photo, setting: Setting) -> float:
    """Side of one pixel of the features' picture in pixels of the stored photo."""
    return max(1.0, max(photo.size) / setting.longest)
