"""Capture -> points: fuse depth frames, clean clouds, isolate the thing, and frame it for the field."""

from __future__ import annotations

from services.edge.points.hint_cloud import hints
from services.edge.points.nouns import Points, UnitFrame
from services.edge.points.scale import with_longest
from services.edge.points.thin import at_most
from services.edge.points.to_points import to_points
from services.edge.points.unit import unit_frame

__all__ = ["Points", "UnitFrame", "at_most", "hints", "to_points", "unit_frame", "with_longest"]
