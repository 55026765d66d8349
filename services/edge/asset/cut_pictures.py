"""Show what a cut has kept beside what it was made from. Never published: surroundings are people's homes."""

from __future__ import annotations

from capture2vr.edge.arrays import Floats
from capture2vr.edge.points.nouns import Points
from capture2vr.edge.render.point_picture import point_picture


def pictures_of_cut(points: Points, to_asset: Floats) -> dict[str, bytes]:
    """Render the points that were kept, and those that they were cut from: JPEG by file name; none without a cut."""
    if points.uncut is None:
        return {}
    return {
        "cut-object.jpg": point_picture(points.xyz, points.rgb, to_asset, points.xyz),
        "cut-scene.jpg": point_picture(points.uncut.xyz, points.uncut.rgb, to_asset, points.xyz),
    }
