"""Close an object that was cut out of its surroundings, where no picture gave depth of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bytes, Floats, Tick, no_tick, part_of, pick
from capture2vr.edge.closing.missing_points import infer_missing
from capture2vr.edge.closing.thin_parts import find_thin_parts
from capture2vr.edge.points.nouns import Points
from capture2vr.edge.points.plane import Plane
from capture2vr.edge.points.unit import unit_frame
from capture2vr.edge.render.place_views import in_unit_frame
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
    if thin is not None:
        points = points.subset(~thin.replaced)
    tick(_THIN)
    missing = infer_missing(unit.to_unit(points.xyz), points.rgb, pictures, below, fill, part_of(tick, _THIN, 1))
    kept = replace(points.subset(~missing.fringe), closed=missing.closed)
    if thin is not None:
        nearest = cKDTree(kept.xyz).query(thin_xyz := unit.to_world(thin.xyz))[1]
        rgb, confidence = pick(kept.rgb, nearest), kept.confidence[nearest]
        kept = _with_points(kept, thin_xyz, rgb, confidence)
    count = len(missing.xyz)
    if not count:
        return kept
    whole = _with_points(kept, unit.to_world(missing.xyz), missing.rgb, np.zeros(count, np.float32))
    return replace(whole, inferred=np.arange(len(whole)) >= len(kept))


def _with_points(points: Points, xyz: Floats, rgb: Bytes | None, confidence: Floats) -> Points:
    """Return the points with more of them behind these."""
    return replace(
        points,
        xyz=np.concatenate([points.xyz, xyz]),
        rgb=None if points.rgb is None or rgb is None else np.concatenate([points.rgb, rgb]),
        confidence=np.concatenate([points.confidence, confidence]),
    )
