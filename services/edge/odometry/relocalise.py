"""Where a camera is in another's frame without a guess: picture features whose depth is known, and a rigid motion."""

from __future__ import annotations

import numpy as np

from services.edge.arrays import Floats
from services.edge.points.icp import Fit, align
from services.edge.points.levels import Level, pyramid

_FEATURES = 600
_CONTRAST = 0.02
"""SIFT's threshold on contrast, half of its default: depth sensors' pictures are soft."""
_RATIO = 0.8
"""A match's distance over the second best one's."""
_REACH = 0.04
"""Relative distance between matched points that agree: depth's noise and a pixel's size."""
_TRIES = 300
_MIN_MATCHES = 12


def recognise(source: tuple[Level, ...], target: Level) -> Fit | None:
    """The sound fit of a source to a target from which nobody knows how far it is, or None."""
    guess = _guess(source[-1], target)
    fit = None if guess is None else align(source, pyramid(target), guess)
    return fit if fit is not None and fit.sound else None


def _guess(source: Level, target: Level) -> Floats | None:
    """Pose (4,4) of the source's camera in the target's from matched features, or None where too few agree."""
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
    return _rigid(a, b)


def _features(level: Level) -> tuple[Floats, Floats] | None:
    """Points (N,3) in the camera's frame and their descriptors (N,128)."""
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


def _rigid(a: Floats, b: Floats) -> Floats | None:
    """The pose with b = pose·a for most matches (N,3), by random threes; None where fewer than _MIN_MATCHES agree."""
    rng = np.random.default_rng(0)
    reach = _REACH * b[:, 2]
    best = np.zeros(len(a), bool)
    for _ in range(_TRIES):
        three = rng.choice(len(a), 3, replace=False)
        agree = np.linalg.norm(_moved(_kabsch(a[three], b[three]), a) - b, axis=1) < reach
        best = agree if agree.sum() > best.sum() else best
    if best.sum() < _MIN_MATCHES:
        return None
    return _kabsch(a[best], b[best])


def _moved(pose: Floats, points: Floats) -> Floats:
    return points @ pose[:3, :3].T + pose[:3, 3]


def _kabsch(a: Floats, b: Floats) -> Floats:
    """The rigid motion (4,4) from a (N,3) to b (N,3) with least squares (Kabsch 1976)."""
    u, _, vt = np.linalg.svd((a - a.mean(axis=0)).T @ (b - b.mean(axis=0)))
    mirror = np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))])
    pose = np.eye(4)
    pose[:3, :3] = vt.T @ mirror @ u.T
    pose[:3, 3] = b.mean(axis=0) - pose[:3, :3] @ a.mean(axis=0)
    return pose
