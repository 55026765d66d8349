"""Downsample point clouds by a voxel grid: one point per voxel, the mean of its points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from services.edge.arrays import Bytes, Floats
from services.edge.points.nouns import Points
from services.edge.points.voxel_grid import sum_groups, voxel_keys
from services.edge.srgb import to_linear, to_srgb


def voxel_downsample(xyz: Floats, rgb: Bytes | None, voxel: float) -> tuple[Floats, Bytes | None]:
    """Downsample to one point per voxel: the mean of its points, with the mean of their colours in linear light."""
    ones = np.ones((len(xyz), 1))
    light = np.zeros((len(xyz), 0)) if rgb is None else to_linear(rgb)
    _, sums = sum_groups(voxel_keys(xyz, voxel), np.concatenate([ones, xyz, light], axis=1))
    means = sums[:, 1:] / sums[:, :1]
    return means[:, :3], None if rgb is None else to_srgb(means[:, 3:])


def voxel_downsample_to(xyz: Floats, rgb: Bytes | None, most: int) -> tuple[Floats, Bytes | None]:
    """Downsample to at most `most` points, by about the smallest voxel that suffices; fewer points stay unchanged."""
    if len(xyz) <= most:
        return xyz, rgb
    voxel = float(np.ptp(xyz, axis=0).max()) / most**0.5
    while (count := len(np.unique(voxel_keys(xyz, voxel)))) > most:
        voxel *= 1.05 * (count / most) ** 0.5
    return voxel_downsample(xyz, rgb, voxel)


def downsample_points(points: Points, most: int) -> Points:
    """Downsample `Points` evenly to at most `most`, with a warning for the report. The confidence becomes its mean."""
    if len(points) <= most:
        return points
    xyz, rgb = voxel_downsample_to(points.xyz, points.rgb, most)
    confidence = np.full(len(xyz), points.confidence.mean(), np.float32)
    warning = f"The {len(points):,} points were downsampled evenly to the {len(xyz):,} that this preset uses."
    return replace(points, xyz=xyz, rgb=rgb, confidence=confidence, warnings=(*points.warnings, warning))
