"""Isolate the object in the middle of a point cloud: remove the floor or table below it, and its surroundings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from capture2vr.edge.arrays import Bools, Floats, Tick, no_tick, pick
from capture2vr.edge.capture.nouns import Cloud
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.points.clusters import LEAST_POINTS, cluster_near, touching_distance
from capture2vr.edge.points.ground import Ground
from capture2vr.edge.points.nouns import CutReport, Points
from capture2vr.edge.points.plane import Plane, largest_plane
from capture2vr.edge.points.removed_parts import largest_doubt
from capture2vr.edge.points.upright import level_with
from capture2vr.sentences.sentence import in_row, say

_PLANE_REACH = 0.012
"""Distance from a plane within which points belong to it, as a share of the points' extent."""
_PLANE_SHARE = 0.15
"""Least share of the points on a supporting plane; a plane with fewer is a face of the object itself."""
_WIDE_PLANE_SHARE = 0.04
"""The same for a plane that reaches farther to the sides than what is over it."""
_UPRIGHT_DEG = 20.0
"""Largest tilt of a supporting plane against the horizontal."""
_ONE_SIDE = 0.9
"""Share of the cameras, or of the points beside a turntable's plate, that must be on one side of a plane."""
_OVER = 0.75
"""Least share of the points that are off a supporting plane that must be over it."""
_NOISE_SHARE = 0.01
"""Share of all points that may be on the other side in any case: noise, where nothing but the plane is seen."""
_DEEP_SLABS = 3.0
"""Depth below a plane, over half its thickness, from which on points are not its noise."""
_PLANES = 4
"""Planes that are tried: a pedestal may have a top, a step and a side before the floor comes."""
_BOTTOM = 0.15
"""Lowest share of the height, in which the turntable's plate is searched."""
_SLAB_SIGMAS = 4.0
"""Half the thickness removed with a plane, over the standard deviation of its points."""
_BEND_SLABS = 2.0
"""Most that the ground may bend away from the plane, over half the thickness removed with it."""
_FLAT_SLABS = 3.0
"""An object lower than this many slabs is flat: 4 cm on a table that a phone measured with 3 mm of noise."""
_MIN_SHARE = 0.015
"""Least share of all points that the object in the middle has."""
_SAMPLED = 100_000
"""Points kept of what a cut was made from: a picture of 360 pixels shows no more."""
Choose = Callable[[Bools, Floats | None], Bools]
"""Chooses the object's points among candidates, masks (N,) of the points; and by the heights (N,) over level ground."""
_ASK = say("if_belongs_to_thing_reconstruct")


@dataclass(frozen=True, slots=True)
class _Cut:
    """A mask (N,) of the object's points, the plane that was removed below it, and a warning, "" without one."""

    thing: Bools
    plane: Plane | None
    warning: str = ""


@dataclass(frozen=True, slots=True)
class IsolatedObject:
    """An object's points, and the plane that it stood on, in their frame; None where none was found.

    kept  mask (N,) of all points that these are among
    """

    points: Points
    support: Plane | None
    kept: Bools


def isolate_object(
    points: Points,
    *,
    aim: Floats | None = None,
    cameras: Floats | None = None,
    turntable: bool = False,
    masked: bool = False,
    choose: Choose | None = None,
    tick: Tick = no_tick,
) -> IsolatedObject:
    """Keep the object in the middle: remove one supporting plane, and all clusters that do not touch the chosen one.

    aim (3,): the point that the cameras looked at, capture frame; None: the middle of the points. cameras (M,3)
    positions. turntable: the points have only the object and perhaps the plate that turns with it, wider than it.
    masked: masks that came with the photos have left out what is around the object. choose: takes the place of the
    choice of the cluster in the middle.
    Up becomes the normal of that plane, if it is nearly level and nothing surer contradicts it. For a flat object
    that lies on the plane, the plane stays, with a warning.

    Raises CaptureError: CAPTURE_NOTHING_LEFT without a cluster of at least `LEAST_POINTS` points.
    """
    origin = np.median(points.xyz, axis=0)
    xyz = points.xyz - origin
    middle = aim - origin if aim is not None else None
    eyes = None if cameras is None else cameras - origin
    near, plane = _near_with_support(xyz, points.up, middle, eyes, turntable=turntable)
    tick(0.93)
    least = LEAST_POINTS if choose else max(LEAST_POINTS, _MIN_SHARE * len(xyz))
    chosen = choose or partial(cluster_near, xyz, middle=middle)
    cut = _cut_off(plane, points.up, xyz, near, chosen, least, silent=turntable or masked)
    tick(1.0)
    if cut.thing.sum() < LEAST_POINTS:
        raise CaptureError(
            "CAPTURE_NOTHING_LEFT",
            say("no_connected_part_points", count=len(xyz), least=LEAST_POINTS),
            hints=(say("reconstruct_without_isolating_thing"), say("keep_thing_in_middle_picture")),
        )
    up, up_source = points.up, points.up_source
    if plane is not None and up is not None:
        up, up_source = level_with(plane.normal, up, up_source)
    doubt, share = ("", 0.0) if choose else _doubt(xyz, cut, near)  # what a person chose leaves none
    asked = in_row(" ", (doubt, _ASK)) if doubt else ""
    thing = replace(
        points.subset(cut.thing),
        warnings=(*points.warnings, *filter(None, (cut.warning, asked))),
        up=up,
        up_source=up_source,
        cut=CutReport("object", say("cut_out_surroundings"), doubt, round(share, 3)),
        uncut=_sample(points),
    )
    return IsolatedObject(thing, None if cut.plane is None else cut.plane.moved(origin), cut.thing)


def _near_with_support(
    xyz: Floats, up: Floats | None, middle: Floats | None, cameras: Floats | None, *, turntable: bool
) -> tuple[Bools, Plane | None]:
    """Find the points (N,) that are not surroundings, and the plane that the object stands on."""
    if turntable and up is not None:
        return np.ones(len(xyz), bool), _turntable_plate(xyz, up)
    near = _near_mask(xyz, middle, cameras)
    return near, _supporting_plane(xyz[near], up, cameras)


def _cut_off(
    plane: Plane | None, up: Floats | None, xyz: Floats, near: Bools, choose: Choose, least: float, *, silent: bool
) -> _Cut:
    """Cut the object off its plane; of one that is too flat for that, the plane stays. silent: none is expected."""
    if plane is None:
        return _Cut(choose(near, None), None, "" if silent else say("no_table_floor_found_below"))
    half = _half_slab(plane)
    height = Ground.about(plane, xyz[near], half, _BEND_SLABS * half).height(xyz)
    level = up is not None and float(plane.normal @ up) > np.cos(np.radians(_UPRIGHT_DEG))
    thing = choose(near & (height > half), height if level else None)
    if _is_flat(xyz[thing], plane) or thing.sum() < least:
        return _Cut(choose(near, None), None, say("thing_too_flat_to_separate"))
    return _Cut(thing, plane)


def _doubt(xyz: Floats, cut: _Cut, near: Bools) -> tuple[str, float]:
    """Find what the cut may have removed of the object itself, among what is near."""
    half = 0.0 if cut.plane is None else _half_slab(cut.plane)
    return largest_doubt(xyz, cut.thing, near, cut.plane, half, touching_distance(xyz[cut.thing]))


def _sample(points: Points) -> Cloud:
    """Return points of a cloud, few enough to keep beside it, for a picture of what the cut was made from."""
    few = np.random.default_rng(0).permutation(len(points))[:_SAMPLED]
    return Cloud(points.xyz[few], pick(points.rgb, few))


def _near_mask(xyz: Floats, middle: Floats | None, cameras: Floats | None) -> Bools:
    """Return a mask (N,) of the points no farther from the middle than the cameras are: beyond are surroundings."""
    if middle is None or cameras is None:
        return np.ones(len(xyz), bool)
    reach = np.median(np.linalg.norm(cameras - middle, axis=1))
    near = np.asarray(np.linalg.norm(xyz - middle, axis=1) <= reach)
    return near if near.sum() >= LEAST_POINTS else np.ones(len(xyz), bool)


def _supporting_plane(xyz: Floats, up: Floats | None, cameras: Floats | None) -> Plane | None:
    """Find the plane that the object stands on, its normal towards the object; None if there is none.

    A level plane, if there is one; else any, such as a wall that the object hangs on, since `up` may only be a guess.
    """
    low, high = np.percentile(xyz, [1, 99], axis=0)
    reach = _PLANE_REACH * float((high - low).max())
    if up is not None and (level := _outermost_plane(xyz, reach, cameras, up)):
        return level
    return _outermost_plane(xyz, reach, cameras, None)


def _outermost_plane(xyz: Floats, reach: float, cameras: Floats | None, up: Floats | None) -> Plane | None:
    """Find the largest plane, level if `up` is given, with the cameras and nearly all points on one side of it.

    A plane with points on both sides, such as the top of a pedestal, is part of the object: its points are left out,
    and the next one is searched.
    """
    left = xyz
    for _ in range(_PLANES):
        plane = largest_plane(left, reach, along=up, within_deg=_UPRIGHT_DEG)
        if plane is None or (share := plane.share * len(left) / len(xyz)) < _WIDE_PLANE_SHARE:
            return None
        large = share >= _PLANE_SHARE
        if up is not None and cameras is None and large:
            return plane
        if base := _as_base(plane, xyz, cameras, large=large):
            return base
        left = left[np.abs(plane.height(left)) > _half_slab(plane)]
        if len(left) < LEAST_POINTS:
            break
    return None


def _as_base(plane: Plane, xyz: Floats, cameras: Floats | None, *, large: bool) -> Plane | None:
    """Return a plane with its normal towards the cameras, or most points, if the object stands on it; else None.

    large: whether it has enough of the points to be no foot or step of the object
    """
    upward = plane if np.mean(plane.height(xyz if cameras is None else cameras) >= 0) >= 0.5 else plane.flipped()
    half = _half_slab(plane)
    stands_on = _is_base(upward.height(xyz), half) and (cameras is None or _is_below(upward.height(cameras), half))
    return upward if stands_on and (large or _is_wider(xyz, upward)) else None


def _is_wider(xyz: Floats, plane: Plane) -> bool:
    """Return whether a plane reaches farther to the sides than what is over it, as a floor does and a foot does not."""
    heights = plane.height(xyz)
    aside = xyz - heights[:, None] * plane.normal
    on, over = np.abs(heights) <= _half_slab(plane), heights > _half_slab(plane)
    if not on.any() or not over.any():
        return False
    away = np.linalg.norm(aside - np.median(aside[on], axis=0), axis=1)
    return float(np.percentile(away[on], 95)) > float(np.percentile(away[over], 95))


def _is_below(cameras: Floats, half_slab: float) -> bool:
    """Return whether a plane has nearly all cameras over it; their heights over it (M,)."""
    above, below = int((cameras > half_slab).sum()), int((cameras < -half_slab).sum())
    return above >= _ONE_SIDE * (above + below)


def _is_base(points: Floats, half_slab: float) -> bool:
    """Return whether most of what is off a plane is over it; the points' heights over it (N,).

    Below lie noise, though not deep, and reflections in it; below the top of a pedestal lies the pedestal.
    """
    above, below = int((points > half_slab).sum()), int((points < -_DEEP_SLABS * half_slab).sum())
    return below <= max((1 - _OVER) * (above + below), _NOISE_SHARE * len(points))


def _turntable_plate(xyz: Floats, up: Floats) -> Plane | None:
    """Find a turntable's plate: a level plane below everything else and wider than it; not a lid, a shelf or a foot."""
    height = xyz @ up
    low, high = np.percentile(height, [1, 99])
    reach = _PLANE_REACH * float(np.ptp(xyz, axis=0).max())
    bottom = xyz[height <= low + _BOTTOM * (high - low)]
    plane = largest_plane(bottom, reach, along=up, within_deg=_UPRIGHT_DEG)
    if plane is None:
        return None
    if np.mean(plane.height(xyz) < -_half_slab(plane)) > 1 - _ONE_SIDE:
        return None
    return plane if _is_wider(xyz, plane) else None


def _is_flat(thing: Floats, plane: Plane) -> bool:
    """Return whether removing the plane's slab would remove much of the object, such as all but a garment's folds."""
    return len(thing) == 0 or float(np.percentile(plane.height(thing), 95)) < _FLAT_SLABS * _half_slab(plane)


def _half_slab(plane: Plane) -> float:
    """Return half the thickness that is removed with the plane, in the points' units."""
    return _SLAB_SIGMAS * plane.spread
