"""Close an object that was cut out of its surroundings, where no picture gave depth of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from capture2vr.edge.arrays import Tick, no_tick
from capture2vr.edge.closing.missing_points import infer_missing
from capture2vr.edge.points.nouns import Points
from capture2vr.edge.points.plane import Plane
from capture2vr.edge.points.unit import unit_frame
from capture2vr.edge.render.place_views import in_unit_frame
from capture2vr.order.option_table import Fill


def close_object(points: Points, support: Plane | None, fill: Fill, tick: Tick = no_tick) -> Points:
    """Add points where an object has surface that no picture gave depth of, and drop those of fringes beside it.

    support  the plane that it stood on, with its normal to the object
    """
    if fill == "none" or not points.texture_views:
        tick(1.0)
        return points
    unit = unit_frame(points.xyz)
    below = None if support is None else support.moved(-unit.centre).scaled(1 / unit.size)
    pictures = in_unit_frame(points.texture_views, unit)
    missing = infer_missing(unit.to_unit(points.xyz), points.rgb, pictures, below, fill, tick)
    kept, count = replace(points.subset(~missing.fringe), closed=missing.closed), len(missing.xyz)
    if not count:
        return kept
    return replace(
        kept,
        xyz=np.concatenate([kept.xyz, unit.to_world(missing.xyz)]),
        rgb=None if kept.rgb is None or missing.rgb is None else np.concatenate([kept.rgb, missing.rgb]),
        confidence=np.concatenate([kept.confidence, np.zeros(count, np.float32)]),
        inferred=np.arange(len(kept) + count) >= len(kept),
    )
