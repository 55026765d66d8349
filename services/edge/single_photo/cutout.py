"""Cut the thing out of a photo, and crop the square around it that the network sees. numpy and OpenCV.

The photo's mask or alpha channel decides, where there is one. Otherwise a rectangle that a person drew does; without
one, what stands out from a plain background; and where nothing does, the largest thing near the middle is proposed.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import cv2
import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats, no_tick
from capture2vr.edge.capture.masks import OPAQUE, with_masks
from capture2vr.edge.capture.nouns import Photo
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.single_photo.boxed import segment_in_box
from capture2vr.edge.single_photo.plain_background import segment_by_colour
from capture2vr.edge.single_photo.proposal import propose
from capture2vr.edge.single_photo.segmentation import no_object
from capture2vr.order.photo_box import WHOLE, PhotoBox
from capture2vr.sentences.sentence import say

LONGEST = 320
"""Longest side in pixels of the picture that is segmented: GrabCut takes 0.2 s, and the network sees only 64."""
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
    """

    rgb: Bytes
    mask: Bools
    area: PhotoBox = WHOLE
    warnings: tuple[str, ...] = ()

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


def cut_out(photo: Photo, box: PhotoBox | None = None) -> CutOut:
    """Segment the thing in a photo: by its mask or alpha channel, if that hides anything, else by colour. A mask that
    is broken or of another shape is not used, with a warning.

    box  the rectangle that the thing lies in, where a person has drawn one

    Raises CaptureError CAPTURE_NO_OBJECT where there is no thing, or what there is is cut off on every side.
    """
    (photo,), warnings = with_masks([photo], no_tick)
    tells = photo.mask is not None and not photo.mask.all()
    cut = _cut_by_mask(photo, box) if tells else _cut_by_colour(photo, box)
    return replace(cut, warnings=(*warnings, *cut.warnings))


def _cut_by_colour(photo: Photo, box: PhotoBox | None) -> CutOut:
    """Cut out what is in the rectangle; without one, what stands out, or is proposed. Raises CAPTURE_NO_OBJECT."""
    if box is None or box.width * box.height > _ALL:
        area = box or WHOLE
        return _cut_whole(_load_area(photo, area), area, photo.name)
    area = box.grown(_AROUND)
    rgb = _load_area(photo, area)
    return CutOut(rgb, segment_in_box(rgb, *_pixels(box, area, rgb.shape), photo.name), area)


def rotate_clockwise(pixels: Bytes, turns: int) -> Bytes:
    """Rotate pixels clockwise by so many quarter turns."""
    return np.ascontiguousarray(np.rot90(pixels, -turns))


def crop_square(cut: CutOut, side: int, fill: float, *, shift: tuple[float, float] = (0.0, 0.0)) -> Floats:
    """Crop a square around the thing -> (side,side,4) float32 in [0,1]: colours times mask, and mask.

    The thing's longer side takes `fill` of the square; its middle lies `shift` squares right of and below the square's.
    """
    rows, columns = np.flatnonzero(cut.mask.any(axis=1)), np.flatnonzero(cut.mask.any(axis=0))
    top, bottom, left, right = rows[0], rows[-1] + 1, columns[0], columns[-1] + 1
    length = max(bottom - top, right - left) / fill
    x0 = (left + right) / 2 - length * (0.5 + shift[0])
    y0 = (top + bottom) / 2 - length * (0.5 + shift[1])
    # Where the photo is finer than the square, warp to a multiple of the square's size, then average. Pixel i lies at
    # x0 + (i + ½)·by − ½ of the photo.
    fine = side * max(1, int(np.ceil(length / side)))
    by = length / fine
    warp = np.array([[by, 0, x0 + by / 2 - 0.5], [0, by, y0 + by / 2 - 0.5]])
    mask = cut.mask[..., None].astype(np.float32)
    layers = np.concatenate([cut.rgb / np.float32(255) * mask, mask], axis=2)
    drawn = cv2.warpAffine(layers, warp, (fine, fine), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    return np.asarray(cv2.resize(drawn, (side, side), interpolation=cv2.INTER_AREA), np.float32)


def _cut_whole(rgb: Bytes, area: PhotoBox, name: str) -> CutOut:
    """Cut out what stands out; where nothing does, what is proposed, with a warning. Raises CAPTURE_NO_OBJECT."""
    with suppress(CaptureError):
        return CutOut(rgb, segment_by_colour(rgb, name), area)
    proposed = CutOut(rgb, propose(rgb, name), area)
    warning = say("nothing_stands_out_from_background", name=name, bounds=proposed.bounds())
    return replace(proposed, warnings=(warning,))


def _cut_by_mask(photo: Photo, box: PhotoBox | None) -> CutOut:
    """Cut out what the photo's mask shows in the rectangle. Raises CAPTURE_NO_OBJECT where that is nothing."""
    assert photo.mask is not None
    stored = photo.load(LONGEST)
    height, width = stored.shape[:2]
    small = cv2.resize(255 * photo.mask.astype(np.uint8), (width, height), interpolation=cv2.INTER_AREA)
    mask = rotate_clockwise(np.asarray(small, np.uint8), photo.turns) >= OPAQUE
    if box:
        rows, columns = _pixels(box, WHOLE, mask.shape)
        chosen = np.zeros_like(mask)
        chosen[rows, columns] = mask[rows, columns]
        mask = chosen
    if not mask.any():
        advice = say("draw_rectangle_around_thing_send")
        raise no_object(photo.name, say("transparent_everywhere_in_rectangle"), advice)
    return CutOut(rotate_clockwise(stored, photo.turns), mask)


def _load_area(photo: Photo, area: PhotoBox) -> Bytes:
    """Load a part of the upright photo, its longer side `LONGEST` pixels where the photo has as many.

    Raises CAPTURE_NO_OBJECT for a part of hardly any pixels.
    """
    sides = photo.size if photo.turns % 2 == 0 else photo.size[::-1]
    shown = max(area.width * sides[0], area.height * sides[1])
    longest = min(max(sides), round(LONGEST * max(sides) / shown))
    upright = rotate_clockwise(photo.load(longest), photo.turns)
    rows, columns = _pixels(area, WHOLE, upright.shape)
    part = np.ascontiguousarray(upright[rows, columns])
    if min(part.shape[:2]) < _LEAST_SIDE:
        seen = say("pixels_where_looked_too_few", width=part.shape[1], height=part.shape[0])
        raise no_object(photo.name, seen, say("take_larger_photo_draw_larger"))
    return part


def _pixels(box: PhotoBox, area: PhotoBox, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Rows and columns of a rectangle in a picture of this shape that shows `area` of the photo."""
    left, right = (round((x - area.left) / area.width * shape[1]) for x in (box.left, box.right))
    top, bottom = (round((y - area.top) / area.height * shape[0]) for y in (box.top, box.bottom))
    return slice(top, bottom), slice(left, right)
