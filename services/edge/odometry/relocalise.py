"""Relocalise a camera relative to another without an initial guess: SIFT features with depth, and a rigid motion."""

from __future__ import annotations

import numpy as np

from services.edge.arrays import Floats
from services.edge.odometry.icp import IcpFit, align
from services.edge.odometry.pyramid import Level, pyramid
from services.edge.procrustes import procrustes

_FEATURES = 600
"""Most features per picture."""
_CONTRAST = 0.02
"""SIFT's contrast threshold, half of its default: the pictures of depth sensors are soft."""
_RATIO = 0.8
"""Ratio test: largest descriptor distance of a match over that of the second best."""
_REACH = 0.04
"""Largest distance, relative to the depth, between matched points that agree: covers depth noise and a pixel's size."""
_TRIES = 300
"""Rounds of RANSAC."""
_MIN_MATCHES = 12
"""Least number of matches, and of inliers."""


def relocalise(source: tuple[Level, ...], target: Level) -> IcpFit | None:
    """Align a source to a target at an unknown distance, by feature matching and ICP; None unless the fit is sound."""
    guess = _guess(source[-1], target)
    fit = None if guess is None else align(source, pyramid(target), guess)
    return fit if fit is not None and fit.sound else None


def _guess(source: Level, target: Level) -> Floats | None:
    """Estimate the pose (4,4) of the source's camera in the target's from matched features; None if too few agree."""
    import cv2

    here, there = _features(source), _features(target)
    if here is None or there is None:
        return None
    pairs = cv2.BFMatcher().knnMatch(here[1], there[1], k=2)
    good = [
        best for best, second in (pair for pair in pairs if len(pair) == 2) if best.distance < _RATIO * second.distance
    ]
    if len(good) < _MIN_MATCHES:
        return None
    a = here[0][[match.queryIdx for match in good]]
    b = there[0][[match.trainIdx for match in good]]
    return _ransac_rigid(a, b)


def _features(level: Level) -> tuple[Floats, Floats] | None:
    """Detect SIFT features with known depth: points (N,3) in the camera's frame and descriptors (N,128), or None."""
    import cv2

    if level.grey is None:
        return None
    sift = cv2.SIFT.create(nfeatures=_FEATURES, contrastThreshold=_CONTRAST)
    points, descriptors = sift.detectAndCompute((level.grey * 255).astype(np.uint8), None)
    if len(points) < _MIN_MATCHES:
        return None
    at = np.rint([point.pt for point in points]).astype(int)
    pixel = at[:, 1] * level.camera.width + at[:, 0]
    q = level.inverse_depth.ravel()[pixel]
    known = q > 0
    return level.rays[pixel[known]] / q[known, None], np.asarray(descriptors)[known]


def _ransac_rigid(a: Floats, b: Floats) -> Floats | None:
    """Find the pose with b = pose·a for most matches (N,3), by RANSAC; None where fewer than _MIN_MATCHES agree."""
    rng = np.random.default_rng(0)
    reach = _REACH * b[:, 2]
    best = np.zeros(len(a), bool)
    for _ in range(_TRIES):
        three = rng.choice(len(a), 3, replace=False)
        pose = procrustes(a[three], b[three], scale=False)
        if pose is None:  # two of the three points are equal
            continue
        agree = np.linalg.norm(_transform(pose, a) - b, axis=1) < reach
        best = agree if agree.sum() > best.sum() else best
    if best.sum() < _MIN_MATCHES:
        return None
    return procrustes(a[best], b[best], scale=False)


def _transform(pose: Floats, points: Floats) -> Floats:
    """Transform points (N,3) by a pose (4,4)."""
    return points @ pose[:3, :3].T + pose[:3, 3]
