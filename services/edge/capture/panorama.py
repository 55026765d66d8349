"""Split pictures of 360 degrees into perspective views, which structure from motion can place.

A panorama is equirectangular: columns are longitudes, rows latitudes. Cameras and programs say so in XMP (Google's
"Photo Sphere XMP Metadata"); where a program has dropped that, the pixels tell.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.capture.nouns import LoadPhoto, Photo
from capture2vr.edge.capture.photo_copy import PhotoCopy

VIEWS = 8
"""Views of a panorama: neighbours share half of what they show, and each is there again in the next panorama."""
_FIELD = 90.0  # degrees
_HEAD_BYTES = 256 * 1024
"""Bytes from the start of a file in which XMP is looked for: it comes before the pixels."""
_PROJECTION = b"equirectangular"
_TILTED = re.compile(rb"""Pose(?:Pitch|Roll)Degrees\s*(?:=\s*["']|>)\s*-?0*([1-9]|0*\.\d*[1-9])""")
_LONGEST_PX = 256  # of the picture whose pixels are asked
_WRAPS = 2.0
"""Most change from the last column to the first one, in changes between neighbours."""
_POLE = 0.5
"""Most deviation in the first and the last row, which each show one place, over the rows' median."""
_UPRIGHT, _PLAIN = 0.3, 8.0
"""Least deviation in the first column, over the columns' median, and in grey levels: a thing before plain cloth has
none there."""


def is_panorama(path: Path, photo: Photo) -> bool:
    """Return whether a photo shows 360 by 180 degrees. Raises IMAGE_UNREADABLE."""
    width, height = photo.size
    return width == 2 * height and (_PROJECTION in _head(path) or _looks_so(photo.load(_LONGEST_PX).astype(np.float64)))


def views_of(path: Path, photo: Photo) -> list[Photo]:
    """Split a panorama into views to all sides, from the middle of its picture on to the right.

    Where it has XMP and is not tilted, gravity is known in them.
    """
    side = max(1, round(photo.size[0] * _FIELD / 360))
    head = _head(path)
    level = _PROJECTION in head and not _TILTED.search(head)
    view = replace(
        photo,
        size=(side, side),
        camera=f"panorama, {side} px",
        focal_px=side / 2 / float(np.tan(np.radians(_FIELD / 2))),
        turns=0,
        load_alpha=None,
        load_mask=None,
        up_in_camera=(0.0, -1.0, 0.0) if level else None,
        elevation_deg=None,
    )
    turns = [360 * number // VIEWS for number in range(VIEWS)]
    return [
        replace(view, name=f"{photo.name}@{turn:03d}", load=PhotoCopy(_View(photo.load, side, turn))) for turn in turns
    ]


def by_direction(panoramas: Sequence[Sequence[Photo]]) -> list[Photo]:
    """Return all views, those to one side after another: so neighbours in the list show the same places."""
    return [view for views in zip(*panoramas, strict=True) for view in views]


@dataclass(frozen=True, slots=True)
class _View:
    """Decodes a view of a panorama, so many degrees to the right of its middle: a `LoadPhoto`."""

    whole: LoadPhoto
    side: int
    turn: float

    def __call__(self, longest: int | None = None) -> Bytes:
        import cv2

        side = min(self.side, longest or self.side)
        panorama = self.whole(None if side == self.side else round(side * 360 / _FIELD))
        height, width = panorama.shape[:2]
        longitude, latitude = _directions(side, self.turn)
        column = ((longitude / 360 + 0.5) % 1 * width - 0.5).astype(np.float32)
        row = np.clip((latitude / 180 + 0.5) * height - 0.5, 0, height - 1).astype(np.float32)
        return np.asarray(cv2.remap(panorama, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP), np.uint8)


def _directions(side: int, turn: float) -> tuple[Floats, Floats]:
    """Longitudes and latitudes downwards, in degrees, (S,S) each, of the pixels of a view."""
    at = (2 * (np.arange(side) + 0.5) / side - 1) * np.tan(np.radians(_FIELD / 2))
    x, y = np.meshgrid(at, at)
    return np.degrees(np.arctan2(x, 1)) + turn, np.degrees(np.arctan2(y, np.hypot(x, 1)))


def _head(path: Path) -> bytes:
    with path.open("rb") as stream:
        return stream.read(_HEAD_BYTES)


def _looks_so(picture: Floats) -> bool:
    """Whether a picture (h,w,3) goes on from its right to its left, and its first and last rows are one place each."""
    step = np.abs(np.diff(picture, axis=1)).mean(axis=(0, 2))
    wraps = np.abs(picture[:, -1] - picture[:, 0]).mean() <= _WRAPS * max(np.median(step), 0.5)
    rows, columns = picture.std(axis=1).mean(axis=1), picture.std(axis=0).mean(axis=1)
    poles = max(rows[0], rows[-1]) <= _POLE * np.median(rows)
    return bool(wraps and poles and columns[0] >= max(_UPRIGHT * np.median(columns), _PLAIN))
