"""SIFT features of a key frame with their places in space, and the matches between two key frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats, Ints
from capture2vr.edge.odometry.pyramid import PyramidLevel

_MOST = 600
"""Most features per picture."""
_CONTRAST = 0.02
"""SIFT's contrast threshold, half of its default: the pictures of depth sensors are soft."""
_RATIO = 0.8
"""Ratio test: largest descriptor distance of a match over that of the second best."""
MIN_MATCHES = 12
"""Least number of features, of matches, and of matches that agree about a motion."""


@dataclass(frozen=True, slots=True)
class RgbdFeatures:
    """points (N,3) float32 in the camera's frame, metres; descriptors (N,128) uint8, SIFT's"""

    points: Floats
    descriptors: Bytes


def features_of(level: PyramidLevel) -> RgbdFeatures | None:
    """Detect a picture's features that have a depth; None without a picture, or with fewer than MIN_MATCHES."""
    import cv2

    if level.grey is None:
        return None
    sift = cv2.SIFT.create(nfeatures=_MOST, contrastThreshold=_CONTRAST)
    found, descriptors = sift.detectAndCompute((level.grey * 255).astype(np.uint8), None)
    if len(found) < MIN_MATCHES:
        return None
    at = np.rint([each.pt for each in found]).astype(int)
    pixel = at[:, 1] * level.camera.width + at[:, 0]
    q = level.inverse_depth.ravel()[pixel]
    known = q > 0
    if known.sum() < MIN_MATCHES:
        return None
    points = level.rays[pixel[known]] / q[known, None]
    return RgbdFeatures(points.astype(np.float32), np.asarray(descriptors)[known].astype(np.uint8))


def match_features(here: RgbdFeatures, there: RgbdFeatures) -> tuple[Ints, Ints] | None:
    """Match features by the ratio test; return their indices (M,) here and there, or None where there are too few."""
    import cv2

    pairs = cv2.BFMatcher().knnMatch(here.descriptors.astype(np.float32), there.descriptors.astype(np.float32), k=2)
    good = [
        best for best, second in (pair for pair in pairs if len(pair) == 2) if best.distance < _RATIO * second.distance
    ]
    if len(good) < MIN_MATCHES:
        return None
    return np.array([match.queryIdx for match in good]), np.array([match.trainIdx for match in good])
