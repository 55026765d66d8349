"""Downsample point clouds by a voxel grid: one point per voxel, the mean of its points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.origin import nearest_origin
from capture2vr.edge.points.nouns import Points
from capture2vr.edge.points.voxel_grid import sum_groups, voxel_keys
from capture2vr.edge.srgb import to_linear, to_srgb
from capture2vr.sentences.sentence import say

_TRIES = 12
"""Most voxels that are tried, each of which takes a tenth of a second for a million points."""


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
    while (count := _filled(xyz, voxel)) > most:
        voxel *= 1.05 * (count / most) ** 0.5
    return voxel_downsample(xyz, rgb, _finer(xyz, voxel, count, most))


def _finer(xyz: Floats, voxel: float, count: int, most: int) -> float:
    """Shrink a voxel of which `count` are filled until at least half of `most` are: a street is long, but of small
    area, and one stray point far away makes any cloud look large."""
    too_fine = 0.0
    for _ in range(_TRIES):
        if count >= most / 2:
            break
        tried = (voxel * too_fine) ** 0.5 if too_fine else voxel * (count / most) ** 0.5
        filled = _filled(xyz, tried)
        if filled > most:
            too_fine = tried
        elif filled >= count:
            voxel, count = tried, filled
        else:
            break  # the grid of keys is at its end
    return voxel


def _filled(xyz: Floats, voxel: float) -> int:
    return len(np.unique(voxel_keys(xyz, voxel)))


def downsample_points(points: Points, most: int) -> Points:
    """Downsample `Points` evenly to at most `most`, with a warning for the report. The confidence becomes its mean."""
    if len(points) <= most:
        return points
    xyz, rgb = voxel_downsample_to(points.xyz, points.rgb, most)
    confidence = np.full(len(xyz), points.confidence.mean(), np.float32)
    warning = say("points_downsampled_evenly_to_preset", count=len(points), left=len(xyz))
    origin = nearest_origin(points.xyz, points.origin, xyz)
    warnings = (*points.warnings, warning)
    return replace(points, xyz=xyz, rgb=rgb, confidence=confidence, origin=origin, warnings=warnings)
