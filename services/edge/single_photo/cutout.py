"""Cut the thing out of a photo. numpy and OpenCV.

The photo's mask or alpha channel decides, where there is one. Otherwise a rectangle that a person drew does, or a place
that a person tapped on; without one, a learned model, where one is installed, else the best of several masks is
proposed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats, Tick, no_tick
from capture2vr.edge.capture.masks import OPAQUE, with_masks
from capture2vr.edge.capture.nouns import Photo
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.models.folder import ModelFolder
from capture2vr.edge.models.nouns import UsedModel
from capture2vr.edge.single_photo.boxed import segment_in_box
from capture2vr.edge.single_photo.learned_cut import learned_cut
from capture2vr.edge.single_photo.proposal import propose, segment_at_tap
from capture2vr.edge.single_photo.segmentation import no_object, part_at
from capture2vr.order.photo_box import WHOLE, PhotoBox
from capture2vr.sentences.sentence import say

LONGEST = 320
"""Longest side in pixels of the picture that is segmented: GrabCut takes 0.1 s, and is asked up to six times."""
_AROUND = 0.15  # of a rectangle's sides: how much is seen around it, to tell the background. 0.35 and 0.7 are worse
_ALL = 0.98  # share of the photo above which a rectangle leaves nothing around it that could tell the background
_LEAST_SIDE = 8  # pixels of what is looked at
_BEND = 0.75  # pixels that an outline may be off the mask's, to have fewer corners

Polygon = tuple[tuple[float, float], ...]
"""Corners (x, y) of a closed line, as shares of the upright photo's width and height."""


@dataclass(frozen=True, slots=True)
class CutOut:
    """A segmented photo: rgb (h,w,3) uint8 upright, and mask (h,w) of the thing.

    area      the part of the photo that `rgb` shows
    warnings  sentences for the person who took the photo
    models    learned models that made the mask
    """

    rgb: Bytes
    mask: Bools
    area: PhotoBox = WHOLE
    warnings: tuple[str, ...] = ()
    models: tuple[UsedModel, ...] = ()

    def outline(self) -> tuple[Polygon, ...]:
        """Outlines of the mask's components, as lines around its pixels."""
        height, width = self.mask.shape
        # Doubled: a contour goes through pixel centres, and so lies a quarter of a pixel inside, not a half.
        doubled = cv2.resize(self.mask.astype(np.uint8), (2 * width, 2 * height), interpolation=cv2.INTER_NEAREST)
        contours, _ = cv2.findContours(doubled, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        bent = [cv2.approxPolyDP(contour, 2 * _BEND, closed=True).reshape(-1, 2) for contour in contours]
        return tuple(self._to_photo((line + 0.5) / [2 * width, 2 * height]) for line in bent if len(line) > 2)

    def bounds(self) -> PhotoBox:
        """The mask's bounding box."""
        rows, columns = np.flatnonzero(self.mask.any(axis=1)), np.flatnonzero(self.mask.any(axis=0))
        corners = np.array([[columns[0], rows[0]], [columns[-1] + 1, rows[-1] + 1]]) / self.mask.shape[::-1]
        (left, top), (right, bottom) = self._to_photo(corners)
        return PhotoBox(left, top, right, bottom)

    def _to_photo(self, places: Floats) -> Polygon:
        """Convert places (n,2), as shares of the picture, to shares of the photo."""
        area = self.area
        whole = places * [area.width, area.height] + [area.left, area.top]
        return tuple((float(x), float(y)) for x, y in whole)


def cut_out(
    photo: Photo,
    box: PhotoBox | None = None,
    models: ModelFolder | None = None,
    tick: Tick = no_tick,
) -> CutOut:
    """Segment the thing in a photo: by its mask or alpha channel, if that hides anything, else by colour. A mask that
    is broken or of another shape is not used, with a warning.

    box     what a person marked: the rectangle that the thing lies in, or a tap on it
    models  learned models, of which one decides where nobody has said what is meant

    Raises CaptureError CAPTURE_NO_OBJECT where there is no thing, or what there is is cut off on every side.
    """
    (photo,), warnings = with_masks([photo], no_tick)
    tells = photo.mask is not None and not photo.mask.all()
    cut = _cut_by_mask(photo, box) if tells else _cut_by_colour(photo, box, models, tick)
    return replace(cut, warnings=(*warnings, *cut.warnings))


def _cut_by_colour(photo: Photo, box: PhotoBox | None, models: ModelFolder | None, tick: Tick) -> CutOut:
    """Cut out what is in the rectangle or at the tap; without them, what a model sees, else what is proposed.

    Raises CAPTURE_NO_OBJECT.
    """
    if box is not None and box.is_tap:
        rgb = _load_area(photo, WHOLE)
        return CutOut(rgb, segment_at_tap(rgb, _pixel(box, rgb.shape), photo.name))
    if box is None or box.width * box.height > _ALL:
        area = box or WHOLE
        rgb = _load_area(photo, area)
        learned = learned_cut(models, lambda longest: _load_area(photo, area, longest), rgb.shape, photo.name, tick)
        if learned.mask is not None:
            return CutOut(rgb, learned.mask, area, learned.warnings, learned.models)
        return _cut_whole(rgb, area, photo.name, learned.warnings)
    area = box.grown(_AROUND)
    rgb = _load_area(photo, area)
    return CutOut(rgb, segment_in_box(rgb, *_pixels(box, area, rgb.shape), photo.name), area)


def rotate_clockwise(pixels: Bytes, turns: int) -> Bytes:
    """Rotate pixels clockwise by so many quarter turns."""
    return np.ascontiguousarray(np.rot90(pixels, -turns))


def _cut_whole(rgb: Bytes, area: PhotoBox, name: str, warnings: tuple[str, ...]) -> CutOut:
    """Cut out what is proposed, with a warning where it does not stand out. Raises CAPTURE_NO_OBJECT.

    warnings  why a learned model did not cut it out, where there is one
    """
    try:
        mask, stands_out = propose(rgb, name)
    except CaptureError as error:
        raise CaptureError(error.code, error.message, file=name, hints=(*error.hints, *warnings)) from None
    proposed = CutOut(rgb, mask, area, warnings)
    if stands_out:
        return proposed
    warning = say("nothing_stands_out_from_background", name=name, bounds=proposed.bounds())
    return replace(proposed, warnings=(*warnings, warning))


def _cut_by_mask(photo: Photo, box: PhotoBox | None) -> CutOut:
    """Cut out what the photo's mask shows in the rectangle. Raises CAPTURE_NO_OBJECT where that is nothing."""
    assert photo.mask is not None
    stored = photo.load(LONGEST)
    height, width = stored.shape[:2]
    small = cv2.resize(255 * photo.mask.astype(np.uint8), (width, height), interpolation=cv2.INTER_AREA)
    mask = rotate_clockwise(np.asarray(small, np.uint8), photo.turns) >= OPAQUE
    if box and box.is_tap:
        mask = part_at(mask, _pixel(box, mask.shape))
        if not mask.any():
            raise no_object(photo.name, say("shows_nothing_at_tap"), say("tap_on_thing_or_draw_rectangle"))
    elif box:
        rows, columns = _pixels(box, WHOLE, mask.shape)
        chosen = np.zeros_like(mask)
        chosen[rows, columns] = mask[rows, columns]
        mask = chosen
    if not mask.any():
        advice = say("draw_rectangle_around_thing_send")
        raise no_object(photo.name, say("transparent_everywhere_in_rectangle"), advice)
    return CutOut(rotate_clockwise(stored, photo.turns), mask)


def _load_area(photo: Photo, area: PhotoBox, most: int = LONGEST) -> Bytes:
    """Load a part of the upright photo, its longer side `most` pixels where the photo has as many.

    Raises CAPTURE_NO_OBJECT for a part of hardly any pixels.
    """
    sides = photo.size if photo.turns % 2 == 0 else photo.size[::-1]
    shown = max(area.width * sides[0], area.height * sides[1])
    longest = min(max(sides), round(most * max(sides) / shown))
    upright = rotate_clockwise(photo.load(longest), photo.turns)
    rows, columns = _pixels(area, WHOLE, upright.shape)
    part = np.ascontiguousarray(upright[rows, columns])
    if min(part.shape[:2]) < _LEAST_SIDE:
        seen = say("pixels_where_looked_too_few", width=part.shape[1], height=part.shape[0])
        raise no_object(photo.name, seen, say("take_larger_photo_draw_larger"))
    return part


def _pixel(tap: PhotoBox, shape: tuple[int, ...]) -> tuple[int, int]:
    """Pixel (x, y) at a tap, in a picture of this shape that shows the whole photo."""
    return min(shape[1] - 1, int(tap.left * shape[1])), min(shape[0] - 1, int(tap.top * shape[0]))


def _pixels(box: PhotoBox, area: PhotoBox, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Rows and columns of a rectangle in a picture of this shape that shows `area` of the photo."""
    left, right = (round((x - area.left) / area.width * shape[1]) for x in (box.left, box.right))
    top, bottom = (round((y - area.top) / area.height * shape[0]) for y in (box.top, box.bottom))
    return slice(top, bottom), slice(left, right)
