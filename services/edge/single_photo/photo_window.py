"""The square part of a photo around the thing in it: its pixels, its mask, and the camera that is assumed for it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats
from capture2vr.edge.capture.nouns import Photo
from capture2vr.edge.models.nouns import LearnedView
from capture2vr.edge.single_photo.cutout import CutOut, rotate_clockwise
from capture2vr.order.photo_box import PhotoBox

GRID = 150
"""Pixels along the longer side of the thing's mask."""
SIDE = 186
"""Pixels along the sides of the square around it: textures take little from a picture's outer 6 %."""
DISTANCE = 4.0
"""Distance of the camera, in longer sides of the thing: nobody knows it, and from far away outlines stay true."""
USUAL_M = 0.4
"""Metres of a thing that fills half of a picture taken at arm's length: an assumption, not a measurement."""


@dataclass(frozen=True, slots=True)
class PhotoWindow:
    """The square part of an upright photo that shows the thing and a margin, which may lie beyond the photo.

    left, top, side  whole pixels of the upright photo; width, height: all of the photo's
    """

    left: int
    top: int
    side: int
    width: int
    height: int

    @classmethod
    def around(cls, photo: Photo, bounds: PhotoBox) -> PhotoWindow:
        """The square around what has these bounds in the photo."""
        width, height = photo.size if photo.turns % 2 == 0 else photo.size[::-1]
        longer = max(bounds.width * width, bounds.height * height)
        side = max(4, round(longer * SIDE / GRID))
        middle = (bounds.left + bounds.right) / 2 * width, (bounds.top + bounds.bottom) / 2 * height
        return cls(round(middle[0] - side / 2), round(middle[1] - side / 2), side, width, height)

    def mask_of(self, cut: CutOut, pixels: int) -> Bools:
        """The mask of what was cut out, pixels × pixels; its border is free."""
        rows, columns = cut.mask.shape
        place = self.left / self.width, self.top / self.height, self.side / self.width, self.side / self.height
        area = cut.area
        by = place[2] / area.width * columns / pixels, place[3] / area.height * rows / pixels
        start = (place[0] - area.left) / area.width * columns, (place[1] - area.top) / area.height * rows
        covered = cut.mask.astype(np.float32)
        soft = np.asarray(cv2.GaussianBlur(covered, (0, 0), max(0.5, max(by) / 2)), np.float32)
        drawn = _warp(soft, start, by, pixels, cv2.BORDER_CONSTANT)
        mask = np.asarray(drawn > 0.5)
        mask[:2] = mask[-2:] = False
        mask[:, :2] = mask[:, -2:] = False
        return mask

    def depth_of(self, view: LearnedView, pixels: int) -> tuple[Floats, float]:
        """Depth, pixels × pixels, of a model's view of the whole photo, and its focal length in pixels of that."""
        assert view.depth_m is not None, "it has depth"
        rows, columns = view.depth_m.shape
        by = self.side / self.width * columns / pixels, self.side / self.height * rows / pixels
        start = self.left / self.width * columns, self.top / self.height * rows
        depth = _warp(view.depth_m, start, by, pixels, cv2.BORDER_CONSTANT, cv2.INTER_NEAREST)
        return depth, view.focal_px / by[0]

    def load(self, photo: Photo, most: int) -> Bytes:
        """Load what the photo shows of it, at most so many pixels long; its edge's pixels where the photo ends."""
        side = min(self.side, most)
        longest = round(max(photo.size) * side / self.side)
        upright = rotate_clockwise(photo.load(longest), photo.turns)
        scale = upright.shape[1] / self.width, upright.shape[0] / self.height
        start = self.left * scale[0], self.top * scale[1]
        by = self.side * scale[0] / side, self.side * scale[1] / side
        return np.asarray(_warp(upright, start, by, side, cv2.BORDER_REPLICATE), np.uint8)


def _warp(
    image: Floats | Bytes,
    start: tuple[float, float],
    by: tuple[float, float],
    side: int,
    border: int,
    way: int = cv2.INTER_LINEAR,
) -> Any:
    """Resample the square of an image that begins at `start` (x, y) with `by` pixels (x, y) for each new one."""
    warp = np.array([[by[0], 0, start[0] + by[0] / 2 - 0.5], [0, by[1], start[1] + by[1] / 2 - 0.5]])
    flags = way | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(image, warp, (side, side), flags=flags, borderMode=border)
