"""Close an object that was cut out of its surroundings, where no picture gave depth of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Tick, no_tick, part_of, pick
from capture2vr.edge.closing.missing_points import infer_missing
from capture2vr.edge.closing.thin_parts import find_thin_parts
from capture2vr.edge.origin import FILLED, MEASURED
from capture2vr.edge.points.clean_cloud import MIN_POINTS
from capture2vr.edge.points.nouns import Points, UnitFrame
from capture2vr.edge.points.plane import Plane
from capture2vr.edge.points.unit import unit_frame
from capture2vr.edge.render.place_views import in_unit_frame
from capture2vr.edge.render.posed_picture import PosedPicture
from capture2vr.order.option_table import Fill

_THIN = 0.3
"""Share of the time that thin parts take."""


def close_object(points: Points, support: Plane | None, fill: Fill, tick: Tick = no_tick) -> Points:
    """Add points where an object has surface that no picture gave depth of, and drop those of fringes beside it.

    Thin parts get theirs by their outlines; they are seen, and not inferred.

    support  the plane that it stood on, with its normal to the object
    """
    if fill == "none" or not points.texture_views:
        tick(1.0)
        return points
    unit = unit_frame(points.xyz)
    below = None if support is None else support.moved(-unit.centre).scaled(1 / unit.size)
    pictures = in_unit_frame(points.texture_views, unit)
    thin = find_thin_parts(unit.to_unit(points.xyz), pictures, below)
    tick(_THIN)
    if thin is None:
        return _closed(points, unit, pictures, below, fill, part_of(tick, _THIN, 1))
    lines = unit.to_world(thin.xyz)
    rest = points.subset(~thin.replaced)
    if len(rest) < MIN_POINTS:  # such as a figure of wire
        rest, coloured = points.subset(np.zeros(len(points), bool)), points
        tick(1.0)
    else:
        rest = _closed(rest, unit, pictures, below, fill, part_of(tick, _THIN, 1))
        coloured = rest.subset(rest.given)
    nearest = cKDTree(coloured.xyz).query(lines)[1]
    return rest.joined(lines, pick(coloured.rgb, nearest), coloured.confidence[nearest], MEASURED)


def _closed(
    points: Points, unit: UnitFrame, pictures: Sequence[PosedPicture], below: Plane | None, fill: Fill, tick: Tick
) -> Points:
    """Return the points with inferred ones; pictures and the plane below are in the unit frame."""
    missing = infer_missing(unit.to_unit(points.xyz), points.rgb, pictures, below, fill, tick)
    kept = replace(points, xyz=unit.to_world(missing.measured), closed=missing.closed).subset(~missing.fringe)
    none_sure = np.zeros(len(missing.xyz), np.float32)
    return kept.joined(unit.to_world(missing.xyz), missing.rgb, none_sure, FILLED)
