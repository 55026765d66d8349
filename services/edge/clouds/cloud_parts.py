"""Read a large point cloud in parts: check all of it once, keep some of its points, and read it again when asked."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from capture2vr.edge.arrays import Bools, Floats, Tick
from capture2vr.edge.capture.files import translate_errors
from capture2vr.edge.capture.nouns import Cloud, CloudParts
from capture2vr.edge.clouds.cloud_process import georeferenced_origin, moved_warning
from capture2vr.edge.clouds.colours import read_colours, rgb8, scale_of
from capture2vr.edge.clouds.raw_parts import LARGE, RawPart, RawParts
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.geodesy.degrees import LocalMap
from capture2vr.edge.geodesy.reference_system import reference_of
from capture2vr.sentences.sentence import say

MAX_COORDINATE = 1e6
"""Units from the origin; beyond it float32 steps are 6 cm, and 1e30 is a broken file."""
MAX_BAD_SHARE = 0.1
"""Share of the points that may lie beyond MAX_COORDINATE; they are dropped with a warning."""
_ZEROS = 3
"""Points at exactly (0, 0, 0) from which on they are what a scanner writes where nothing came back."""


@dataclass(frozen=True, slots=True)
class _Survey:
    """What one reading of all points found: least and greatest finite coordinates (3,), and if all are coloured."""

    low: Floats
    high: Floats
    coloured: bool


def valid_mask(xyz: Floats) -> Bools:
    """Return a mask (N,): True for points that are finite and within MAX_COORDINATE."""
    with np.errstate(invalid="ignore"):
        return np.asarray((np.abs(xyz) <= MAX_COORDINATE).all(axis=1))


def returned(xyz: Floats) -> Floats:
    """Return coordinates (N,3) with NaN where a scanner saw nothing, which some of them write as (0, 0, 0)."""
    nothing = np.asarray(~xyz.any(axis=1))
    return np.where(nothing[:, None], np.nan, xyz) if _ZEROS <= nothing.sum() < len(xyz) else xyz


def dropped_warnings(xyz: Floats, name: str) -> tuple[str, ...]:
    """Say how many of the points (N,3) are dropped as invalid. Those without a return may be any share of a scan.

    Raises CAPTURE_NOT_FINITE where none is left, or more than MAX_BAD_SHARE lie too far away.
    """
    bad, empty = int((~valid_mask(xyz)).sum()), int((~np.isfinite(xyz).all(axis=1)).sum())
    if not bad:
        return ()
    what = say("points_have_coordinates_not_finite", bad=bad, count=len(xyz), most=MAX_COORDINATE)
    if bad == len(xyz) or bad - empty > MAX_BAD_SHARE * len(xyz):
        raise CaptureError("CAPTURE_NOT_FINITE", what, file=name, hints=(say("export_capture_again_in_metres"),))
    return (say("these_points_dropped", file=name, what=what),)


def read_some(parts: RawParts, name: str, tick: Tick) -> tuple[Cloud, CloudParts, tuple[str, ...]]:
    """Read all points once -> every so many-th of them, at most LARGE, all of them in parts, and warnings.

    Raises CAPTURE_NOT_FINITE, and CAPTURE_UNREADABLE where a part cannot be decoded.
    """
    step = -(-parts.count // LARGE)
    found = [_look_at(part, step, tick) for part in _translated(parts, name)]
    survey = _joined([each for each, _ in found])
    some = RawPart(
        np.concatenate([part.xyz for _, part in found]),
        np.concatenate([part.colours for _, part in found if part.colours is not None]) if survey.coloured else None,
    )
    origin = georeferenced_origin(survey.low, survey.high)
    warnings = parts.warnings if origin is None else (*parts.warnings, moved_warning(origin, name))
    rgb, notes = read_colours(some.colours)
    scale = None if rgb is None or some.colours is None else scale_of(some.colours)
    clean = _Clean(np.zeros(3) if origin is None else origin, scale)
    warnings += dropped_warnings(some.xyz - clean.origin, name)
    whole = CloudParts(parts.count, lambda: map(clean, _translated(parts, name)))
    return replace(clean(some), notes=notes, origin=origin), whole, warnings


def first_places(parts: RawParts, name: str) -> Floats:
    """Return the coordinates (N,3) of the first part. Raises CAPTURE_UNREADABLE where that cannot be decoded."""
    return next((part.xyz for part in _translated(parts, name)), np.zeros((0, 3)))


def projected(cloud: Cloud, crs: str = "") -> Cloud:
    """Return a cloud of longitudes, latitudes and heights in metres, on a map in metres around its middle.

    crs  of the degrees, "" for WGS 84; where it is not understood, that of the map is not known either
    """
    xyz = returned(cloud.xyz) if cloud.origin is None else cloud.xyz + cloud.origin
    around = LocalMap.around([xyz])
    return replace(cloud, xyz=around.project(xyz), origin=None, crs=around.crs if _is_known(crs) else "")


def projected_parts(parts: RawParts, name: str, crs: str = "") -> tuple[RawParts, str]:
    """Return parts of longitudes, latitudes and heights, all on one map around the middle of the first, and its crs.

    Raises CAPTURE_UNREADABLE where that cannot be decoded.
    """
    around = LocalMap.around(part.xyz for part in _translated(parts, name))

    def read() -> Iterator[RawPart]:
        for part in _translated(parts, name):
            yield replace(part, xyz=around.project(part.xyz))

    return replace(parts, read=read), around.crs if _is_known(crs) else ""


def _is_known(crs: str) -> bool:
    return not crs or reference_of(crs) is not None


@dataclass(frozen=True, slots=True)
class _Clean:
    """Turns a part as stored into a cloud: near the origin, without invalid points, with 8-bit colours.

    scale  of the colours; None: there are none, or they were never filled
    """

    origin: Floats
    scale: float | None

    def __call__(self, part: RawPart) -> Cloud:
        xyz = part.xyz - self.origin
        colours = None
        if part.colours is not None and self.scale is not None:
            colours = rgb8(part.colours, self.scale)
        return Cloud(xyz, colours).subset(valid_mask(xyz))


def _look_at(part: RawPart, step: int, tick: Tick) -> tuple[_Survey, RawPart]:
    """Survey a part, and pick every `step`-th of its points."""
    tick(0.0)
    with np.errstate(invalid="ignore"):
        finite = part.xyz[np.isfinite(part.xyz).all(axis=1)]
    low, high = finite.min(axis=0, initial=np.inf), finite.max(axis=0, initial=-np.inf)
    colours = part.colours
    picked = RawPart(part.xyz[::step].copy(), None if colours is None else colours[::step].copy())
    return _Survey(low, high, colours is not None), picked


def _joined(surveys: list[_Survey]) -> _Survey:
    return _Survey(
        np.min([each.low for each in surveys], axis=0),
        np.max([each.high for each in surveys], axis=0),
        all(each.coloured for each in surveys),
    )


def _translated(parts: RawParts, name: str) -> Iterator[RawPart]:
    with translate_errors(name, "point cloud"):
        yield from (replace(part, xyz=returned(part.xyz)) for part in parts.read())
