"""Relocalise a camera relative to another without an initial guess: SIFT features with depth, and a rigid motion."""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.odometry.features import MIN_MATCHES, RgbdFeatures, features_of, match_features
from capture2vr.edge.odometry.icp import IcpFit, align
from capture2vr.edge.odometry.pyramid import PyramidLevel, pyramid
from capture2vr.edge.procrustes import procrustes

_REACH = 0.04
"""Largest distance, relative to the depth, between matched points that agree: covers depth noise and a pixel's size."""
_TRIES = 300
"""Rounds of RANSAC."""


def relocalise(source: tuple[PyramidLevel, ...], target: PyramidLevel) -> IcpFit | None:
    """Align a source to a target at an unknown distance, by feature matching and ICP; None unless the fit is sound."""
    here, there = features_of(source[-1]), features_of(target)
    guess = None if here is None or there is None else matched_pose(here, there)
    fit = None if guess is None else align(source, pyramid(target), guess)
    return fit if fit is not None and fit.sound else None


def matched_pose(here: RgbdFeatures, there: RgbdFeatures) -> Floats | None:
    """Estimate the pose (4,4) of one camera in the other's frame from matched features; None if too few agree."""
    matches = match_features(here, there)
    return None if matches is None else _ransac_rigid(here.points[matches[0]], there.points[matches[1]])


def _ransac_rigid(a: Floats, b: Floats) -> Floats | None:
    """Find the pose with b = pose·a for most matches (N,3), by RANSAC; None where fewer than MIN_MATCHES agree."""
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
    if best.sum() < MIN_MATCHES:
        return None
    return procrustes(a[best], b[best], scale=False)


def _transform(pose: Floats, points: Floats) -> Floats:
    """Transform points (N,3) by a pose (4,4)."""
    return points @ pose[:3, :3].T + pose[:3, 3]
