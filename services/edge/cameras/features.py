"""Detect SIFT key points with RootSIFT descriptors: found in a downscaled picture, in pixels of the stored one.

Relja Arandjelović, Andrew Zisserman, "Three things everyone should know to improve object retrieval", CVPR 2012:
the square root of a SIFT histogram compares better than the histogram.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats, Tick, no_tick
from capture2vr.edge.capture.nouns import Photo
from capture2vr.edge.parallel import in_threads


@dataclass(frozen=True, slots=True)
class SiftSettings:
    """Settings of the detection: longer side of the picture in pixels, most key points, SIFT's contrast threshold."""

    longest: int
    count: int
    contrast: float


FAST = SiftSettings(
    800, 1500, 0.015
)  # 50 phone photos: all placed, as exactly as from 1000 px and twice the key points
FINE = SiftSettings(1600, 4096, 0.01)  # for photos that FAST could not place: weak texture, wide steps

_EDGE = 10.0  # SIFT's edge threshold, its default
_SIGMA = 1.6  # pixels; SIFT's default
_OCTAVE_LAYERS = 3  # SIFT's default
_QUANTUM = 512.0  # scale of the roots to bytes: the roots of a histogram that sums to 1 stay below 0.5


@dataclass(frozen=True, slots=True)
class Features:
    """Key points of a photo.

    xy           (K,2) float32 pixels of the stored picture, pixel centres at integers
    descriptors  (D,128) uint8 of the first D key points; the others, if any, come from a network with their matches
    """

    xy: Floats
    descriptors: Bytes


def find_features(photos: Sequence[Photo], setting: SiftSettings, tick: Tick = no_tick) -> list[Features]:
    """Detect the key points of each photo, in threads. Raises what `Photo.load` and `tick` raise."""
    return in_threads(partial(features_of, setting=setting), photos, tick)


def features_of(photo: Photo, setting: SiftSettings) -> Features:
    """Detect the strongest key points of one photo, inside its mask if it has one."""
    grey = cv2.cvtColor(photo.load(setting.longest), cv2.COLOR_RGB2GRAY)
    # SIFT applies the mask only after limiting the count: with a mask, find all points and select the best here.
    count = setting.count if photo.mask is None else 0
    # Without enable_precise_upscale every key point is 0.25 pixels too far right and down.
    sift = cv2.SIFT.create(count, _OCTAVE_LAYERS, setting.contrast, _EDGE, _SIGMA, enable_precise_upscale=True)
    mask = None if photo.mask is None else resize_mask(photo.mask, grey.shape).astype(np.uint8)
    points, histograms = sift.detectAndCompute(grey, mask)
    if not points:
        return Features(np.empty((0, 2), np.float32), np.empty((0, 128), np.uint8))
    if photo.mask is not None:
        best = np.argsort([-point.response for point in points], kind="stable")
        points, histograms = [points[index] for index in best], histograms[best]
    # SIFT returns one point more than the count when two have the same score.
    xy = np.array([point.pt for point in points[: setting.count]])
    ratio = np.divide(photo.size, grey.shape[::-1])
    stored = ((xy + 0.5) * ratio - 0.5).astype(np.float32)
    return Features(stored, root_sift(np.asarray(histograms[: setting.count], np.float32)))


def resize_mask(mask: Bools, shape: tuple[int, ...]) -> Bools:
    """Resize a mask to `shape` (H,W)."""
    resized = cv2.resize(mask.astype(np.uint8), (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST)
    return np.asarray(resized, np.bool_)


def root_sift(histograms: Floats) -> Bytes:
    """Convert SIFT histograms (K,128) to RootSIFT: element-wise square roots after normalising the sums, in 1/512."""
    total = np.maximum(histograms.sum(axis=1, keepdims=True), 1e-7)  # an empty histogram stays empty
    roots: Floats = np.rint(_QUANTUM * np.sqrt(histograms / total))
    return np.clip(roots, 0, 255).astype(np.uint8)


def pixel_ratio(photo: Photo, longest: int) -> float:
    """Return the side of one pixel of the photo downscaled to `longest` pixels, in pixels of the stored photo."""
    return max(1.0, max(photo.size) / longest)
