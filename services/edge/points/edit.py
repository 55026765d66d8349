"""Apply a recipe of edits to points: cut away what is outside a box, behind planes, or in a line that a person drew in
a photo; set what is up and the scale."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from capture2vr.edge.arrays import Bools, Floats, Tick, no_tick
from capture2vr.edge.capture.nouns import Capture, Cloud, CloudParts, UpSource
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.points.clean_cloud import MAX_POINTS, MIN_POINTS, cloud_points
from capture2vr.edge.points.lasso import DrawnView, drawn_views, hide_left_out
from capture2vr.edge.points.nouns import Points
from capture2vr.edge.points.scale import with_scale
from capture2vr.order.edits import CropBox, CutPlane, Edits
from capture2vr.sentences.sentence import say

_BY_PERSON = UpSource("person", 1.0)


def cut_away(points: Points, edits: Edits, tick: Tick = no_tick) -> Points:
    """Keep the points that the recipe's box, planes and lassos keep, also of a large scene's `whole`; of pictures with
    lassos no colours are used where something is left out.

    Where so little of a scene remains that all of it fits, all its points are taken instead of the few that showed the
    scene. Raises EdgeError EDITS_NOTHING_LEFT where fewer than `MIN_POINTS` points remain.
    """
    if not edits.cuts_away:
        return points
    drawn = drawn_views(points.drawn_in, edits.lassos, points.xyz)
    keep = kept_mask(points.xyz, edits, drawn)
    if keep.sum() < MIN_POINTS:
        raise EdgeError(
            "EDITS_NOTHING_LEFT",
            say("edits_leave_points_least_needed", left=int(keep.sum()), count=len(points), least=MIN_POINTS),
            hints=(say("make_crop_box_larger_leave"), say("check_they_capture")),
        )
    # What a person cuts off leaves an opening that must stay one.
    kept = _with_lassos(replace(points.subset(keep), closed=points.closed and bool(keep.all())), edits)
    if points.whole is None:
        return kept
    whole = kept_parts(points.whole, edits, drawn, tick)
    if whole.count <= len(kept):
        return replace(kept, whole=None)
    return replace(kept, whole=whole) if whole.count > MAX_POINTS else _with_all(kept, whole)


def set_frame(points: Points, edits: Edits) -> Points:
    """Set what is up and how long a unit is, as far as the recipe says. The points stay where they are.

    A length that a person measured gives the scale the confidence "estimated", as the longest side does.
    """
    if edits.up is not None:
        up = np.array(edits.up, np.float64)
        points = replace(points, up=up / np.linalg.norm(up), up_source=_BY_PERSON)
    if edits.length is not None:
        points = with_scale(points, edits.length.metres_per_unit)
    return replace(points, edits=edits)


def kept_mask(xyz: Floats, edits: Edits, drawn: Sequence[DrawnView] = ()) -> Bools:
    """Return a mask (N,) of the points (N,3) that a recipe keeps; those on a box's side or on a plane are kept.

    drawn  the photos that its lassos are in
    """
    keep = np.ones(len(xyz), bool)
    if edits.crop is not None:
        keep &= _inside(xyz, edits.crop)
    for plane in edits.planes:
        keep &= _before(xyz, plane)
    for view in drawn:
        keep &= ~view.leaves_out(xyz)
    return keep


def _with_lassos(points: Points, edits: Edits) -> Points:
    """Hide in the pictures what the lassos leave out, and warn of lassos in photos that were not used."""
    if not edits.lassos:
        return points
    frames, lassos = points.drawn_in, edits.lassos
    used = {frame.shown.name for frame in frames if frame.shown}
    unused = tuple(say("lasso_in_had_no_effect", name=name) for name in sorted(edits.photos - used))
    return replace(
        points,
        texture_views=hide_left_out(points.texture_views, frames, lassos),
        held_out_views=hide_left_out(points.held_out_views, frames, lassos),
        scene_views=hide_left_out(points.scene_views, frames, lassos),
        drawn_in=(),
        warnings=(*points.warnings, *unused),
    )


def _inside(xyz: Floats, box: CropBox) -> Bools:
    along = (np.asarray(xyz, np.float64) - np.array(box.centre)) @ np.array(box.axes).T
    return np.asarray((np.abs(along) <= np.array(box.size) / 2).all(axis=1))


def _before(xyz: Floats, plane: CutPlane) -> Bools:
    return np.asarray((np.asarray(xyz, np.float64) - np.array(plane.point)) @ np.array(plane.normal) >= 0)


def kept_parts(whole: CloudParts, edits: Edits, drawn: Sequence[DrawnView] = (), tick: Tick = no_tick) -> CloudParts:
    """Return the parts of a large scene without the points that are cut away. It is read once, to count them."""

    def read() -> Iterator[Cloud]:
        for part in whole.read():
            if (keep := kept_mask(part.xyz, edits, drawn)).any():
                yield part.subset(keep)

    count, done = 0, 0
    for part in whole.read():
        done += len(part.xyz)
        count += int(kept_mask(part.xyz, edits, drawn).sum())
        tick(min(1.0, done / whole.count))
    return CloudParts(count, read)


def _with_all(points: Points, whole: CloudParts) -> Points:
    """Return the points with all of a scene's, cleaned; their confidence is the mean, as a scene's points have none."""
    parts = list(whole.read())
    rgb = [part.rgb for part in parts if part.rgb is not None]
    cloud = Cloud(np.concatenate([part.xyz for part in parts]), np.concatenate(rgb) if rgb else None)
    clean = cloud_points(Capture("points", "edited", cloud=cloud))
    confidence = np.full(len(clean), points.confidence.mean(), np.float32)
    return replace(points, xyz=clean.xyz, rgb=clean.rgb, confidence=confidence, whole=None)
