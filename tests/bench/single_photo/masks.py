"""Masks of one photo against the truth: rendered things before real, busy photos, cut out automatically, by a tap, and
by a rectangle drawn 5 % too large.

A tap is at the place nearest to the middle of the thing that is well within it.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import cv2
import numpy as np

from capture2vr.edge.arrays import Bools
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.single_photo.cutout import CutOut, cut_out
from capture2vr.edge.single_photo.proposal import overlap
from capture2vr.order.photo_box import PhotoBox
from tests.conftest import data_folder
from tests.support.photos.busy_photos import BEHIND, BusyPhoto, busy_photos
from tests.support.photos.single_photos import photo

_LOOSE = 0.05
_WITHIN = 0.5  # of the greatest distance from the outline that the thing has anywhere
_GOOD = 0.8

WAYS: dict[str, Callable[[BusyPhoto], CutOut]] = {
    "automatic": lambda each: cut_out(photo(each.rgb)),
    "a tap": lambda each: cut_out(photo(each.rgb), tap_on(each.mask)),
    "a rectangle": lambda each: cut_out(photo(each.rgb), box_around(each.mask)),
}


def main(arguments: list[str]) -> None:
    """Print a table for photos behind that constants were chosen on, and one for others."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench masks", description=__doc__)
    parser.add_argument("--count", type=int, default=60, help="photos of each table")
    given = parser.parse_args(arguments)
    for which in BEHIND:
        photos = list(busy_photos(data_folder(), which, given.count))
        print(f"\n{len(photos)} photos, {which}\n\n| cut out by | IoU mean | median | over {_GOOD} | refused | CPU-s |")
        print("|---|---|---|---|---|---|")
        for name, way in WAYS.items():
            began = time.process_time()
            found = np.array([_overlap(way, each) for each in photos])
            seconds = (time.process_time() - began) / len(photos)
            refused, good = int((found == 0).sum()), (found > _GOOD).mean()
            figures = f"{found.mean():.3f} | {np.median(found):.3f} | {good:.0%} | {refused} | {seconds:.2f}"
            print(f"| {name} | {figures} |", flush=True)


def tap_on(mask: Bools) -> PhotoBox:
    """Where a person would tap on a thing."""
    away = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5)
    within = np.argwhere(away >= _WITHIN * away.max())
    row, column = within[np.argmin(((within - np.argwhere(mask).mean(axis=0)) ** 2).sum(axis=1))]
    return PhotoBox.of([(column + 0.5) / mask.shape[1], (row + 0.5) / mask.shape[0]])


def box_around(mask: Bools) -> PhotoBox:
    """The rectangle that a person would draw around a thing."""
    return CutOut(np.zeros((*mask.shape, 3), np.uint8), mask).bounds().grown(_LOOSE)


def _overlap(way: Callable[[BusyPhoto], CutOut], each: BusyPhoto) -> float:
    try:
        cut = way(each)
    except CaptureError:
        return 0.0
    found, (height, width) = np.zeros_like(each.mask), each.mask.shape
    left, right = (round(x * width) for x in (cut.area.left, cut.area.right))
    top, bottom = (round(y * height) for y in (cut.area.top, cut.area.bottom))
    part = cv2.resize(cut.mask.astype(np.uint8), (right - left, bottom - top), interpolation=cv2.INTER_NEAREST)
    found[top:bottom, left:right] = part > 0
    return overlap(found, each.mask)
