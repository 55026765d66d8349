"""Crop photos lazily: the crop is exact at whatever size a photo is loaded."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from capture2vr.edge.arrays import Bytes
from capture2vr.edge.capture.nouns import LoadPhoto, Photo


@dataclass(frozen=True, slots=True)
class CropRectangle:
    """A crop rectangle, in shares of the picture's width and height."""

    left: float
    top: float
    right: float
    bottom: float

    def pixels(self, size: tuple[int, int]) -> tuple[int, int, int, int]:
        """Return left, top, width and height in a picture of `size`; a box symmetric about the middle stays so."""
        width, height = size
        left, top = _pixels(self.left * width), _pixels(self.top * height)
        right, bottom = _pixels((1 - self.right) * width), _pixels((1 - self.bottom) * height)
        return left, top, max(1, width - left - right), max(1, height - top - bottom)


def _pixels(length: float) -> int:
    """Round to whole pixels, 37.4999999 like 37.5: both sides of a centred box must be rounded alike."""
    return round(round(length, 6))


def crop_photo(photo: Photo, box: CropRectangle) -> Photo:
    """Crop a photo without a pose to a box.

    If the box is centred in the photo, the optical axis stays in the middle of the crop."""
    left, top, width, height = box.pixels(photo.size)
    mask = photo.mask
    if mask is not None:
        mask = _cut(mask.astype(np.uint8), photo.size, (left, top, width, height), cv2.INTER_NEAREST).astype(bool)
    load = _CropLoader(photo.load, photo.size, (left, top, width, height))
    part = _part_of(photo, (left, top, width, height))
    return replace(photo, size=(width, height), load=load, load_alpha=None, load_mask=None, mask=mask, part=part)


def _part_of(photo: Photo, pixels: tuple[int, int, int, int]) -> tuple[float, float, float, float]:
    """Return which part of the stored picture a crop (left, top, width, height) of a photo, itself a part, shows."""
    (left, top, right, bottom), (x, y, width, height) = photo.part, pixels
    across, down = (right - left) / photo.size[0], (bottom - top) / photo.size[1]
    return left + x * across, top + y * down, left + (x + width) * across, top + (y + height) * down


@dataclass(frozen=True, slots=True)
class _CropLoader:
    """Loads the part (left, top, width, height) of a photo of `size`: a `LoadPhoto`."""

    whole: LoadPhoto
    size: tuple[int, int]
    part: tuple[int, int, int, int]

    def __call__(self, longest: int | None = None) -> Bytes:
        wanted = None if longest is None else max(1, int(longest * max(self.size) / max(self.part[2:])))
        return _cut(self.whole(wanted), self.size, self.part, cv2.INTER_CUBIC)


def _cut(pixels: Bytes, size: tuple[int, int], part: tuple[int, int, int, int], method: int) -> Bytes:
    """Cut a part, given in pixels of `size`, out of a picture of any scale, with subpixel accuracy.

    Rounding to whole pixels would move the optical axis."""
    left, top, width, height = part
    by_x, by_y = pixels.shape[1] / size[0], pixels.shape[0] / size[1]
    columns, rows = max(1, round(width * by_x)), max(1, round(height * by_y))
    if (by_x, by_y) == (1, 1):
        return np.ascontiguousarray(pixels[top : top + height, left : left + width])
    step_x, step_y = width * by_x / columns, height * by_y / rows
    warp = np.array(
        [[step_x, 0, left * by_x + (step_x - 1) / 2], [0, step_y, top * by_y + (step_y - 1) / 2]], np.float64
    )
    flags = method | cv2.WARP_INVERSE_MAP
    return np.asarray(
        cv2.warpAffine(pixels, warp, (columns, rows), flags=flags, borderMode=cv2.BORDER_REPLICATE), np.uint8
    )
