"""A point cloud as somebody's app exported it -> clean points."""

from __future__ import annotations

import numpy as np

from services.edge.arrays import Bytes, Floats, Tick, no_tick
from services.edge.capture.nouns import Capture, ScaleConfidence
from services.edge.errors import CaptureError
from services.edge.points.grid import voxel_keys
from services.edge.points.nouns import Points
from services.edge.points.outliers import inliers
from services.edge.points.thin import thin, thin_to

MAX_POINTS = 1_000_000
"""Points kept of a cloud: the neighbour searches of a larger one take minutes, and the finest mesh shows no more."""
MIN_POINTS = 100
"""Fewer distinct points than this are no surface."""
_SAME = 1e-6
"""Points closer than this share of the cloud's size are one point: float32 files hold no more."""
_REPORTED = 0.001
"""Share of strays from which on the report mentions them."""
_SMALLEST_M, _LARGEST_M = 0.05, 30.0
"""Longest sides of what people scan with a phone, a cup to a large room."""
_CONFIDENCE = 0.5
"""A bare cloud says nothing about how well each point was measured."""


def cloud_points(capture: Capture, *, voxel: float | None = None, tick: Tick = no_tick) -> Points:
    """Drop duplicates and strays; thin only to `voxel` (capture units) when given, or where over `MAX_POINTS` remain.

    Raises CaptureError: CAPTURE_TOO_FEW_POINTS where fewer than `MIN_POINTS` distinct points remain.
    """
    if capture.cloud is None:
        raise ValueError("a capture of points has a cloud")
    read = len(capture.cloud.xyz)
    finite = np.asarray(np.isfinite(capture.cloud.xyz).all(axis=1))
    xyz: Floats = np.asarray(capture.cloud.xyz, np.float64)[finite]
    rgb = None if capture.cloud.rgb is None else capture.cloud.rgb[finite]
    origin = xyz.min(axis=0) if len(xyz) else np.zeros(3)
    xyz, rgb = _distinct(xyz - origin, rgb)
    if voxel is not None:
        xyz, rgb = thin(xyz, rgb, voxel)
    xyz, rgb = thin_to(xyz, rgb, MAX_POINTS)
    _require_points(read, len(xyz))
    tick(0.1)
    keep = inliers(xyz, lambda fraction: tick(0.1 + 0.9 * fraction))
    _require_points(read, int(keep.sum()))
    xyz, rgb = xyz[keep] + origin, None if rgb is None else rgb[keep]
    metres_per_unit, scale_confidence, warnings = _scale(capture, xyz)
    strays = int(len(keep) - keep.sum())
    if strays > _REPORTED * len(keep):
        warnings += (f"{strays} stray points ({strays / len(keep):.1%}) were removed.",)
    return Points(
        xyz=xyz,
        rgb=rgb,
        confidence=np.full(len(xyz), _CONFIDENCE, np.float32),
        metres_per_unit=metres_per_unit,
        scale_confidence=scale_confidence,
        up=capture.up,
        warnings=capture.warnings + warnings,
    )


def _distinct(xyz: Floats, rgb: Bytes | None) -> tuple[Floats, Bytes | None]:
    """The first of all points that coincide, in the files' order."""
    size = float(xyz.max(initial=0))
    _, first = np.unique(voxel_keys(xyz, max(size * _SAME, 1e-300)), return_index=True)
    first = np.sort(first)
    return xyz[first], None if rgb is None else rgb[first]


def _scale(capture: Capture, xyz: Floats) -> tuple[float, ScaleConfidence, tuple[str, ...]]:
    """Metres per unit. A bare cloud is believed to be in metres when that makes it something one could walk around."""
    if capture.scale_confidence != "unknown":
        return capture.metres_per_unit, capture.scale_confidence, ()
    longest = float(np.ptp(xyz, axis=0).max())
    if _SMALLEST_M <= longest * capture.metres_per_unit <= _LARGEST_M:
        return capture.metres_per_unit, "unknown", ()
    warning = f"The cloud is {longest:.3g} units long in units nobody named; it was scaled to a longest side of 1 m."
    return 1 / longest, "unknown", (warning,)


def _require_points(read: int, left: int) -> None:
    if left < MIN_POINTS:
        raise CaptureError(
            "CAPTURE_TOO_FEW_POINTS",
            f"of {read} points {left} distinct ones are left; at least {MIN_POINTS} are needed",
            hints=("Scan the thing again, more slowly and from closer.", "Export the cloud at its full resolution."),
        )
