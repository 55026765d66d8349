"""Segment the thing inside a rectangle that a person drew. Nothing outside of it belongs to the thing. OpenCV."""

from __future__ import annotations

import cv2
import numpy as np

from capture2vr.edge.arrays import Bools, Bytes
from capture2vr.edge.single_photo.segmentation import grab_cut, has_contrast, main_part, no_object
from capture2vr.sentences.sentence import say

_LEAST_PX = 16  # least side of a rectangle in pixels of the photo: less shows no shape
_LEAST_SHARE = 0.05  # of the rectangle, that a thing covers; people draw it around the thing
_ADVICE = say("draw_rectangle_around_whole_thing")


def segment_in_box(rgb: Bytes, rows: slice, columns: slice, name: str) -> Bools:
    """Mask (h,w) of the thing in the rectangle of these rows and columns, which does not fill the picture.

    GrabCut starts from the ellipse in the rectangle, with what is outside as the background. Raises CaptureError
    CAPTURE_NO_OBJECT.
    """
    height, width = rows.stop - rows.start, columns.stop - columns.start
    if min(height, width) < _LEAST_PX:
        reason = say("has_x_pixels_in_rectangle", width=width, height=height, w=_LEAST_PX, h=_LEAST_PX)
        raise no_object(name, reason, say("draw_larger_rectangle"), say("take_photo_from_closer"))
    box = np.zeros(rgb.shape[:2], bool)
    box[rows, columns] = True
    mask = main_part(grab_cut(rgb, _seeds(box, rows, columns)) & box) & box
    if mask.sum() < _LEAST_SHARE * box.sum() or not has_contrast(rgb, mask):
        raise no_object(name, say("shows_nothing_in_rectangle_whose"), _ADVICE)
    return mask


def _seeds(box: Bools, rows: slice, columns: slice) -> Bytes:
    """GrabCut's initial labels: perhaps the thing in the ellipse, perhaps not in the corners, surely not outside."""
    seeds = np.where(box, cv2.GC_PR_BGD, cv2.GC_BGD).astype(np.uint8)
    middle = (columns.start + columns.stop) // 2, (rows.start + rows.stop) // 2
    half = (columns.stop - columns.start) // 2, (rows.stop - rows.start) // 2
    cv2.ellipse(seeds, middle, half, 0, 0, 360, cv2.GC_PR_FGD, cv2.FILLED)
    seeds[~box] = cv2.GC_BGD
    return seeds
