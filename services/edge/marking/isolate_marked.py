"""Isolate the object that a person marked by a rectangle or a tap, and mask it in all photos."""

from __future__ import annotations

import posixpath
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from capture2vr.edge.arrays import Bools, Floats, Tick, no_tick
from capture2vr.edge.capture.frame_records import first_names
from capture2vr.edge.capture.nouns import Capture, ShownPicture
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.fusion.texture_views import texture_view
from capture2vr.edge.marking.marked_object import Mark, choose_marked, middle_of
from capture2vr.edge.marking.outline_points import outline_points, seen_points
from capture2vr.edge.parallel import in_threads
from capture2vr.edge.points.isolate import IsolatedObject, isolate_object
from capture2vr.edge.points.nouns import Points, TextureView
from capture2vr.edge.render.place_views import posed_picture
from capture2vr.edge.render.posed_picture import PosedPicture
from capture2vr.edge.render.sample_image import shrink_to
from capture2vr.edge.single_photo.cutout import LONGEST as SEGMENTED_PX
from capture2vr.edge.single_photo.proposal import segment_at_tap
from capture2vr.order.option_table import Cut
from capture2vr.order.photo_box import PhotoBox
from capture2vr.sentences.sentence import say

_HERE = np.eye(4)  # photos and points share the capture's frame


def with_marked_photo(capture: Capture, box: PhotoBox | None) -> PhotoBox | None:
    """Return a rectangle with the name of the photo that it is drawn in, which it may name without its folder; where it
    names none, that of the first one.

    Raises CaptureError: BOX_NOT_APPLICABLE for a capture without photos, BOX_UNKNOWN_PHOTO for another photo's name.
    """
    if box is None:
        return None
    names = [photo.name for photo in capture.photos]
    names += [frame.shown.name for frame in capture.frames if frame.shown and frame.load_rgb]
    if not names:
        reason = say("rectangle_needs_a_photo", format=capture.format)
        raise CaptureError("BOX_NOT_APPLICABLE", reason, hints=(say("leave_rectangle_out_box"),))
    meant = _meant(box.photo, names)
    if len(meant) != 1:
        reason = say("rectangle_in_unknown_photo", photo=box.photo, names=first_names(names))
        raise CaptureError("BOX_UNKNOWN_PHOTO", reason, hints=(say("name_one_them_as_capture"),))
    return replace(box, photo=meant[0])


def _meant(photo: str, names: Sequence[str]) -> list[str]:
    """Return those of the names that are a photo's, without their folders where none is the whole name; the first one
    for a rectangle that names no photo."""
    if not photo:
        return [*names[:1]]
    file = posixpath.basename(photo)
    return [name for name in names if name == photo] or [name for name in names if posixpath.basename(name) == file]


def what_to_keep(capture: Capture, cut: Cut, box: PhotoBox | None) -> Cut | Mark:
    """Return the mark that a rectangle makes in the photo that it names, or one around what a tap is on; what is cut
    without one, or where all is kept.

    Raises CaptureError: BOX_PHOTO_UNUSED where that photo has no frame, CAPTURE_NO_OBJECT where a tap is on nothing.
    """
    if box is None or cut == "scene":
        return cut
    for frame in capture.frames:
        if frame.shown and frame.shown.name == box.photo and frame.load_rgb:
            picture = posed_picture(texture_view(frame), _HERE)
            return Mark(picture, frame.shown, _around_tapped(picture, frame.shown, box) if box.is_tap else box)
    why = next((each.advice for each in capture.verdicts if each.name == box.photo and each.advice), "")
    hints = (say("draw_rectangle_in_another_photo"), *filter(None, [why]))
    raise CaptureError("BOX_PHOTO_UNUSED", say("rectangle_in_unused_photo"), file=box.photo, hints=hints)


def _around_tapped(picture: PosedPicture, shown: ShownPicture, tap: PhotoBox) -> PhotoBox:
    """Return the rectangle around what a person tapped on. Raises CaptureError CAPTURE_NO_OBJECT."""
    rgb = shrink_to(picture.load_rgb(), SEGMENTED_PX)
    height, width = rgb.shape[:2]
    rows, columns = np.indices((height, width)).reshape(2, -1)
    upright = shown.to_upright((np.column_stack([columns, rows]) + 0.5) / (width, height))
    nearest = int(np.linalg.norm(upright - tap.values[:2], axis=1).argmin())
    mask = segment_at_tap(rgb, (int(columns[nearest]), int(rows[nearest])), shown.name)
    covered = upright[mask.ravel()]
    return PhotoBox.unchecked([*np.clip([*covered.min(axis=0), *covered.max(axis=0)], 0.0, 1.0), tap.photo])


def isolate_marked(
    points: Points, mark: Mark, *, cameras: Floats, turntable: bool = False, tick: Tick = no_tick
) -> IsolatedObject:
    """Keep the marked object, as `isolate_object` keeps the one in the middle, and mask it in the views of the points.

    Raises CaptureError CAPTURE_NOTHING_LEFT where nothing in the rectangle has depth.
    """
    aim = middle_of(mark, points.xyz)
    if aim is None:
        raise _no_depth(mark)
    pictures = [
        mark.picture,
        *(posed_picture(view, _HERE) for view in points.texture_views if view.name != mark.picture.name),
    ]

    def choose(candidates: Bools, _: Floats | None) -> Bools:
        return choose_marked(points.xyz, points.rgb, candidates, mark, pictures)

    try:
        isolated = isolate_object(points, aim=aim, cameras=cameras, turntable=turntable, choose=choose, tick=tick)
    except CaptureError:
        raise _no_depth(mark) from None
    masked = partial(_masked_views, xyz=points.xyz, is_object=isolated.kept)
    kept = isolated.points
    kept = replace(kept, texture_views=masked(kept.texture_views), held_out_views=masked(kept.held_out_views))
    return replace(isolated, points=kept)


def _no_depth(mark: Mark) -> CaptureError:
    hints = (say("draw_rectangle_around_whole_thing"), say("again_matt"))
    return CaptureError("CAPTURE_NOTHING_LEFT", say("marked_gave_no_depth"), file=mark.shown.name, hints=hints)


def _masked_views(views: Sequence[TextureView], *, xyz: Floats, is_object: Bools) -> tuple[TextureView, ...]:
    """Give each view a mask of the object, where it has none and shows the object's points (N,) among all (N,3)."""

    def masked(view: TextureView) -> TextureView:
        picture = posed_picture(view, _HERE)
        outline = None if view.load_mask else outline_points(picture, seen_points(picture, xyz), is_object)
        return view if outline is None else replace(view, load_mask=partial(np.asarray, outline))

    return tuple(in_threads(masked, views))
