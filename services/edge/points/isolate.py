"""The thing in the middle, without what it stands on and what stands around it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from services.edge.arrays import Bools, Floats, Ints, Tick, no_tick
from services.edge.errors import CaptureError
from services.edge.points.nouns import Points
from services.edge.points.outliers import connected
from services.edge.points.plane import Plane, largest_plane

_PLANE_REACH = 0.012
"""Thickness searched for a plane, as a share of the points' extent."""
_PLANE_SHARE = 0.15
"""A plane with fewer of the points is a face of the thing, not what it stands on."""
_UPRIGHT_DEG = 20.0
"""What things stand on is level within this."""
_ONE_SIDE = 0.9
"""Share of the cameras, or without cameras of the other points, that must be on one side of a plane."""
_BOTTOM = 0.15
"""Of the height: where a plate is looked for."""
_SLAB_SIGMAS = 4.0
_FLAT_SLABS = 3.0
"""A thing lower than this many slabs is flat: 4 cm on a table that a phone saw with 3 mm of noise."""
_LINK_SPACINGS = 4.0
"""Points within this many median spacings belong together."""
_TOUCH_LINKS = 2.0
"""A cluster this many links from the chosen one is a part that the scan left loose."""
_NEAR_MIDDLE = 0.05
"""Distance from the middle at which a cluster's points count half, as a share of the points' extent."""
_PROBE = 20_000
"""Points enough to measure the spacing."""
_MIN_SHARE = 0.015
_MIN_POINTS = 100
"""A thing has at least this many points and this share of all."""


def isolate_object(
    points: Points,
    *,
    aim: Floats | None = None,
    cameras: Floats | None = None,
    turntable: bool = False,
    tick: Tick = no_tick,
) -> Points:
    """Keep the thing in the middle: remove one supporting plane, and everything that does not touch the chosen cluster.

    aim (3,): what the cameras looked at, capture frame; None: the middle of the points. cameras (M,3) positions.
    turntable: nothing is there but the thing and perhaps a plate that turns with it, wider than the thing.
    A flat thing that is its own plane stays, with a warning. Raises CaptureError: CAPTURE_NOTHING_LEFT where no cluster
    of at least `_MIN_POINTS` points exists.
    """
    origin = np.median(points.xyz, axis=0)
    xyz = points.xyz - origin
    if turntable and points.up is not None:
        plane = _plate(xyz, points.up)
    else:
        plane = _support(xyz, points.up, None if cameras is None else cameras - origin)
    tick(0.93)
    middle = aim - origin if aim is not None else None
    everything = np.ones(len(xyz), bool)
    if plane is None:
        kept = _thing(xyz, everything, middle)
        warning = "" if turntable else "No supporting plane was found; only separate clutter was removed."
    else:
        above = plane.height(xyz) > _slab(plane)
        kept, warning = _thing(xyz, above, middle), ""
        if _is_flat(xyz[kept], plane) or kept.sum() < max(_MIN_POINTS, _MIN_SHARE * len(xyz)):
            kept = _thing(xyz, everything, middle)
            warning = "The thing is as flat as what it lies on; the supporting plane was kept."
    tick(1.0)
    if kept.sum() < _MIN_POINTS:
        raise CaptureError(
            "CAPTURE_NOTHING_LEFT",
            f"of {len(xyz)} points no connected part has {_MIN_POINTS}",
            hints=("Reconstruct without isolating the thing.", "Keep the thing in the middle of the picture."),
        )
    warnings = (*points.warnings, warning) if warning else points.warnings
    rgb = None if points.rgb is None else points.rgb[kept]
    return replace(points, xyz=points.xyz[kept], rgb=rgb, confidence=points.confidence[kept], warnings=warnings)


def _support(xyz: Floats, up: Floats | None, cameras: Floats | None) -> Plane | None:
    """The plane that the thing stands on, its normal towards the thing; None where there is none."""
    low, high = np.percentile(xyz, [1, 99], axis=0)
    reach = _PLANE_REACH * float((high - low).max())
    level = largest_plane(xyz, reach, along=up, within_deg=_UPRIGHT_DEG) if up is not None else None
    if level is not None and level.share >= _PLANE_SHARE and cameras is None:
        return level
    # Not level: a wall that the thing hangs on, or an up that was only a guess.
    plane = level if level is not None and level.share >= _PLANE_SHARE else largest_plane(xyz, reach)
    if plane is None or plane.share < _PLANE_SHARE:
        return None
    heights = plane.height(cameras if cameras is not None else xyz)
    above, below = np.sum(heights > _slab(plane)), np.sum(heights < -_slab(plane))
    if above + below == 0:
        return plane
    if max(above, below) < _ONE_SIDE * (above + below):
        return None
    return plane if above >= below else plane.flipped()


def _plate(xyz: Floats, up: Floats) -> Plane | None:
    """The level plane below all else and wider than it, as a turntable's plate is; not a lid, a shelf or a foot."""
    height = xyz @ up
    low, high = np.percentile(height, [1, 99])
    reach = _PLANE_REACH * float(np.ptp(xyz, axis=0).max())
    bottom = xyz[height <= low + _BOTTOM * (high - low)]
    plane = largest_plane(bottom, reach, along=up, within_deg=_UPRIGHT_DEG)
    if plane is None:
        return None
    above = plane.height(xyz)
    on, over = np.abs(above) <= _slab(plane), above > _slab(plane)
    if np.mean(above < -_slab(plane)) > 1 - _ONE_SIDE or not over.any():
        return None
    away = np.linalg.norm(xyz - height[:, None] * up - np.median(xyz[on] - height[on, None] * up, axis=0), axis=1)
    return plane if np.percentile(away[on], 95) > np.percentile(away[over], 95) else None


def _is_flat(thing: Floats, plane: Plane) -> bool:
    """Whether the slab that goes with the plane would take much of the thing: a garment would leave only its folds."""
    return len(thing) == 0 or float(np.percentile(plane.height(thing), 95)) < _FLAT_SLABS * _slab(plane)


def _slab(plane: Plane) -> float:
    """Half the thickness that goes with the plane, in the points' units."""
    return _SLAB_SIGMAS * plane.spread


def _thing(xyz: Floats, candidates: Bools, middle: Floats | None) -> Bools:
    """Of the candidates (N,) the cluster that is large and near the middle (3,), and what touches it."""
    from scipy.spatial import cKDTree

    kept = np.zeros(len(xyz), bool)
    index = np.flatnonzero(candidates)
    if len(index) < _MIN_POINTS:
        return kept
    left = xyz[index]
    link = _LINK_SPACINGS * _spacing(left)
    label = connected(left, link)
    middle = np.median(left, axis=0) if middle is None else middle
    chosen = _choose(left, label, middle)
    while True:
        reach, _ = cKDTree(left[chosen]).query(left[~chosen], distance_upper_bound=_TOUCH_LINKS * link, workers=-1)
        touching = np.unique(label[~chosen][np.isfinite(reach)])
        if not len(touching):
            break
        chosen |= np.isin(label, touching)
    kept[index[chosen]] = True
    return kept


def _choose(xyz: Floats, label: Ints, middle: Floats) -> Bools:
    """The cluster with the most points; they count less the farther the nearest of them is from the middle."""
    size = np.bincount(label)
    distance = np.full(len(size), np.inf)
    np.minimum.at(distance, label, np.linalg.norm(xyz - middle, axis=1))
    scale = _NEAR_MIDDLE * float(np.ptp(xyz, axis=0).max())
    return np.asarray(label == np.argmax(size / (1 + (distance / scale) ** 2)))


def _spacing(xyz: Floats) -> float:
    """Median distance to the nearest other point."""
    from scipy.spatial import cKDTree

    some = xyz[np.random.default_rng(0).permutation(len(xyz))[:_PROBE]]
    distance, _ = cKDTree(xyz).query(some, k=2, workers=-1)
    return float(np.median(distance[:, 1]))
