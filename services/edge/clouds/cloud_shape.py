"""Check that points describe a surface: enough distinct ones, which do not lie on a line."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from capture2vr.edge.arrays import Floats
from capture2vr.edge.errors import CaptureError
from capture2vr.sentences.sentence import say

MIN_DISTINCT = 100  # distinct points; fewer do not describe a surface
MIN_SECOND_EXTENT = 1e-4  # of the first principal extent; below it all points lie on a line
# Hash multipliers: odd, hence invertible modulo 2^64, with the bits of the golden ratio and of the roots of 3 and 5.
_ODD_FACTORS = np.array([0x9E3779B97F4A7C15, 0xBB67AE8584CAA73B, 0x3C6EF372FE94F82B], np.uint64)
_SAMPLE = 100_000  # points used for the principal extents; fast also for a cloud of 20 million


def check_shape(xyz: Floats, name: str) -> None:
    """Raise CAPTURE_TOO_FEW_POINTS or CAPTURE_DEGENERATE for points that cannot describe a surface."""
    hint = (say("walk_around_thing_scan_again"),)
    if len(xyz) < MIN_DISTINCT:
        what = say("has_only_points_least_needed", count=len(xyz), least=MIN_DISTINCT)
        raise CaptureError("CAPTURE_TOO_FEW_POINTS", what, file=name, hints=hint)
    if (xyz == xyz[0]).all():
        what = say("has_all_points_same_position", count=len(xyz))
        raise CaptureError("CAPTURE_DEGENERATE", what, file=name, hints=hint)
    if (distinct := _count_distinct(xyz)) < MIN_DISTINCT:
        what = say("has_only_distinct_points_least", count=distinct, least=MIN_DISTINCT)
        raise CaptureError("CAPTURE_TOO_FEW_POINTS", what, file=name, hints=hint)
    first, second, _ = _extents(xyz)
    if second < MIN_SECOND_EXTENT * first:
        raise CaptureError("CAPTURE_DEGENERATE", say("has_all_points"), file=name, hints=hint)


def _count_distinct(xyz: Floats) -> int:
    """Count the distinct points; if a sample has MIN_DISTINCT of them already, return the sample's count."""
    few = len(np.unique(xyz[:: max(1, len(xyz) // 10_000)], axis=0))
    return few if few >= MIN_DISTINCT or len(xyz) < 10_000 else len(np.unique(_hash_points(xyz)))


def _hash_points(xyz: Floats) -> NDArray[np.uint64]:
    """Hash each point to one integer (N,): sorting millions of rows takes seconds, sorting integers a tenth of one.

    Among a hundred points two collide once in 10^15 captures; the count of distinct points is then one too low.
    """
    bits = (np.ascontiguousarray(xyz, np.float64) + 0.0).view(np.uint64)  # + 0.0 turns -0 into 0
    mixed = bits ^ (bits >> np.uint64(29))  # low bits of a double are often 0, and a product carries only upwards
    hashed: NDArray[np.uint64] = (mixed * _ODD_FACTORS).sum(axis=1, dtype=np.uint64)
    return hashed


def _extents(xyz: Floats) -> Floats:
    """Return the standard deviations (3,) of the points along their principal axes, largest first."""
    some = xyz[:: max(1, len(xyz) // _SAMPLE)]
    extents: Floats = np.linalg.svd(some - some.mean(axis=0), compute_uv=False) / np.sqrt(len(some))
    return extents
