"""Fewer points where there are more than a stage can use: one per voxel, the mean of its points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from services.edge.arrays import Bytes, Floats
from services.edge.points.grid import sum_groups, voxel_keys
from services.edge.points.nouns import Points
from services.edge.srgb import to_linear, to_srgb


def thin(xyz: Floats, rgb: Bytes | None, voxel: float) -> tuple[Floats, Bytes | None]:
    """One point per voxel: the mean of its points, coloured with the mean of their light."""
    ones = np.ones((len(xyz), 1))
    light = np.zeros((len(xyz), 0)) if rgb is None else to_linear(rgb)
    _, sums = sum_groups(voxel_keys(xyz, voxel), np.concatenate([ones, xyz, light], axis=1))
    means = sums[:, 1:] / sums[:, :1]
    return means[:, :3], None if rgb is None else to_srgb(means[:, 3:])


def thin_to(xyz: Floats, rgb: Bytes | None, most: int) -> tuple[Floats, Bytes | None]:
    """At most `most` points: as they are where that holds, thinned by the smallest voxel that suffices otherwise."""
    if len(xyz) <= most:
        return xyz, rgb
    voxel = float(np.ptp(xyz, axis=0).max()) / most**0.5
    while (count := len(np.unique(voxel_keys(xyz, voxel)))) > most:
        voxel *= 1.05 * (count / most) ** 0.5
    return thin(xyz, rgb, voxel)


def at_most(points: Points, most: int) -> Points:
    """The points, thinned evenly to at most `most`; the report says so."""
    if len(points) <= most:
        return points
    xyz, rgb = thin_to(points.xyz, points.rgb, most)
    confidence = np.full(len(xyz), points.confidence.mean(), np.float32)
    warning = f"Of {len(points):,} points this preset uses {len(xyz):,}, evenly thinned."
    return replace(points, xyz=xyz, rgb=rgb, confidence=confidence, warnings=(*points.warnings, warning))
