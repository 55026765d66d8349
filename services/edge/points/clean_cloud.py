"""Clean a point cloud that an app exported: remove duplicates and outliers, and downsample if it is too large."""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats, Tick, no_tick, pick
from capture2vr.edge.capture.nouns import Capture, Cloud, CloudParts, ScaleConfidence
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.points.downsample import voxel_downsample, voxel_downsample_to
from capture2vr.edge.points.nouns import Points
from capture2vr.edge.points.outliers import inliers
from capture2vr.edge.points.voxel_grid import voxel_keys
from capture2vr.sentences.sentence import say

MAX_POINTS = 1_000_000
"""Most points of a cleaned cloud: neighbour searches in more take minutes, and the finest mesh shows no more detail."""
MIN_POINTS = 100
"""Least number of distinct points; fewer do not describe a surface."""
_SAME = 1e-6
"""Points closer than this share of the cloud's size are one point: float32 files have no better resolution."""
_FEW, _FAR = 0.01, 100.0
"""Share of points at either end of each axis that do not tell the cloud's size, and how many such sizes from the middle
a point may lie."""
_REPORTED = 0.001
"""Share of outliers from which on the report mentions them."""
_SMALLEST_M, _LARGEST_M = 0.05, 30.0
"""Range of the longest side of what people scan with a phone: from a cup to a large room."""
_CONFIDENCE = 0.5
"""Confidence of every point of a cloud, whose file says nothing about how well a point was measured."""


def cloud_points(capture: Capture, *, voxel: float | None = None, tick: Tick = no_tick) -> Points:
    """Remove duplicates and outliers; downsample to `voxel` (capture units) if given, and to at most `MAX_POINTS`.

    Raises CaptureError: CAPTURE_TOO_FEW_POINTS when fewer than `MIN_POINTS` distinct points remain.
    """
    if capture.cloud is None:
        raise ValueError(say("capture_has_no_point_cloud"))
    read = len(capture.cloud.xyz)
    finite = np.asarray(np.isfinite(capture.cloud.xyz).all(axis=1))
    xyz: Floats = np.asarray(capture.cloud.xyz, np.float64)[finite]
    rgb = pick(capture.cloud.rgb, finite)
    near = _near_the_others(xyz)
    xyz, rgb = xyz[near], pick(rgb, near)
    origin = xyz.min(axis=0) if len(xyz) else np.zeros(3)
    xyz, rgb = _remove_duplicates(xyz - origin, rgb)
    if voxel is not None:
        xyz, rgb = voxel_downsample(xyz, rgb, voxel)
    xyz, rgb = voxel_downsample_to(xyz, rgb, MAX_POINTS)
    _require_points(read, len(xyz))
    tick(0.1)
    keep = inliers(xyz, lambda fraction: tick(0.1 + 0.9 * fraction))
    _require_points(read, int(keep.sum()))
    xyz, rgb = xyz[keep] + origin, pick(rgb, keep)
    metres_per_unit, scale_confidence, warnings = _scale(capture, xyz)
    strays = int(len(keep) - keep.sum() + len(near) - near.sum())
    if strays > _REPORTED * len(keep):
        warnings += (say("stray_points_outliers_removed", strays=strays, share=strays / len(keep)),)
    return Points(
        xyz=xyz,
        rgb=rgb,
        confidence=np.full(len(xyz), _CONFIDENCE, np.float32),
        metres_per_unit=metres_per_unit,
        scale_confidence=scale_confidence,
        up=capture.up,
        up_source=None if capture.up is None else capture.up_source,
        warnings=capture.warnings + warnings,
        whole=capture.whole or _whole(capture.cloud),
        offset=capture.cloud.origin,
        crs=capture.cloud.crs,
    )


def _whole(cloud: Cloud) -> CloudParts | None:
    """All points of a cloud in memory, where there are more than are kept."""
    if len(cloud.xyz) <= MAX_POINTS:
        return None
    return CloudParts(len(cloud.xyz), lambda: iter((Cloud(cloud.xyz, cloud.rgb),)))


def _near_the_others(xyz: Floats) -> Bools:
    """Return a mask (N,): False for points so far from nearly all others that these would coincide: see `_SAME`."""
    if not len(xyz):
        return np.ones(0, bool)
    low, middle, high = np.quantile(xyz, (_FEW, 0.5, 1 - _FEW), axis=0)
    farthest = _FAR * float((high - low).max())
    return np.asarray((np.abs(xyz - middle) <= farthest).all(axis=1)) if farthest else np.ones(len(xyz), bool)


def _remove_duplicates(xyz: Floats, rgb: Bytes | None) -> tuple[Floats, Bytes | None]:
    """Remove duplicates: keep the first of all points that coincide, in the file's order."""
    size = float(xyz.max(initial=0))
    _, first = np.unique(voxel_keys(xyz, max(size * _SAME, 1e-300)), return_index=True)
    first = np.sort(first)
    return xyz[first], pick(rgb, first)


def _scale(capture: Capture, xyz: Floats) -> tuple[float, ScaleConfidence, tuple[str, ...]]:
    """Return metres per unit, its confidence, and warnings.

    A cloud of unknown scale is assumed to be in metres if it then has a plausible size, else scaled to 1 m.
    """
    if capture.scale_confidence != "unknown":
        return capture.metres_per_unit, capture.scale_confidence, ()
    longest = float(np.ptp(xyz, axis=0).max())
    if _SMALLEST_M <= longest * capture.metres_per_unit <= _LARGEST_M:
        return capture.metres_per_unit, "unknown", ()
    warning = say("cloud_long_in_unknown_unit", longest=longest)
    return 1 / longest, "unknown", (warning,)


def _require_points(read: int, left: int) -> None:
    """Raise CAPTURE_TOO_FEW_POINTS when fewer than `MIN_POINTS` are left."""
    if left < MIN_POINTS:
        raise CaptureError(
            "CAPTURE_TOO_FEW_POINTS",
            say("points_only_distinct_ones_left", read=read, left=left, least=MIN_POINTS),
            hints=(say("scan_thing_again_more_slowly"), say("export_cloud_full_resolution")),
        )
