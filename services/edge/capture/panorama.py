"""Split panoramas into perspective views, which structure from motion can place.

A panorama is equirectangular: columns are longitudes, rows latitudes, of all sides or of some. Cameras and programs say
so in XMP (Google's "Photo Sphere XMP Metadata"); where a program has dropped that, the pixels tell one of all sides.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain, zip_longest
from pathlib import Path

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.capture.images import same_shape
from capture2vr.edge.capture.nouns import LoadPhoto, Photo
from capture2vr.edge.capture.photo_copy import PhotoCopy
from capture2vr.order.panorama_names import AREA

VIEWS = 8
"""Views of a panorama of all sides: neighbours share half of what they show, and each is there again in the next
panorama."""
_FIELD = 90.0  # degrees of a view, or as many as there are
_NARROWEST = 30.0  # degrees: what is lower or narrower is taken for a photo, which it hardly differs from
_HEAD_BYTES = 256 * 1024
"""Bytes from the start of a file in which XMP is looked for: it comes before the pixels."""
_PROJECTION = b"equirectangular"
_TAG = rb"""GPano:%s(?:\s*=\s*["']|>)\s*(\d{1,6})(?:\.\d*)?\s*["'<]"""
_TILTED = re.compile(rb"""Pose(?:Pitch|Roll)Degrees\s*(?:=\s*["']|>)\s*-?0*+(?:[1-9]|\.0*+[1-9])""")
_LONGEST_PX = 256  # of the picture whose pixels are asked
_WRAPS = 2.0
"""Most change from the last column to the first one, in changes between neighbours."""
_POLE = 0.5
"""Most deviation in the first and the last row, which each show one place, over the rows' median."""
_UPRIGHT, _PLAIN = 0.3, 8.0
"""Least deviation in the first column, over the columns' median, and in grey levels: a thing before plain cloth has
none there."""


@dataclass(frozen=True, slots=True)
class Coverage:
    """What a panorama shows, in degrees: longitudes from left to right of its middle, latitudes downwards."""

    left: float = -180.0
    right: float = 180.0
    top: float = -90.0
    bottom: float = 90.0

    @property
    def across(self) -> float:
        return self.right - self.left

    @property
    def is_whole(self) -> bool:
        """Whether it goes all around, so that its left continues its right."""
        return self.across >= 360

    @property
    def half_fields(self) -> tuple[float, float]:
        """Degrees from the middle of a view to its sides, across and down: views look at the horizon."""
        return min(_FIELD, self.across) / 2, min(_FIELD / 2, -self.top, self.bottom)

    @property
    def turns(self) -> list[float]:
        """Directions of the views, in degrees to the right of the panorama's middle."""
        if self.is_whole:
            return [360 / VIEWS * number for number in range(VIEWS)]
        half, _ = self.half_fields
        free = self.across - 2 * half
        count = 1 + round(free / (360 / VIEWS))
        return (
            np.linspace(self.left + half, self.right - half, count).tolist()
            if count > 1
            else [(self.left + self.right) / 2]
        )


ALL_SIDES = Coverage()


def coverage_of(path: Path, photo: Photo) -> Coverage | None:
    """Return what a photo shows, where it is a panorama; None of others. Raises IMAGE_UNREADABLE."""
    width, height = photo.size
    head = _head(path)
    if _PROJECTION in head and (part := _part_of(head, photo.size)) is not None:
        return part if min(2 * half for half in part.half_fields) >= _NARROWEST else None
    if width != 2 * height:
        return None
    return ALL_SIDES if _PROJECTION in head or _looks_so(photo.load(_LONGEST_PX).astype(np.float64)) else None


def _part_of(head: bytes, size: tuple[int, int]) -> Coverage | None:
    """Return the part of all directions that XMP says a picture of this size shows; None where it says none.

    The picture may be a smaller copy: only shares of the whole count.
    """
    found = {name: match for name in AREA if (match := re.search(_TAG % name, head))}
    if len(found) < len(AREA):
        return None
    whole_x, whole_y, across, down, left, top = (float(found[name][1]) for name in AREA)
    inside = 0 < left + across <= whole_x and 0 < top + down <= whole_y
    if not inside or not across or not down or not same_shape(size, (round(across), round(down))):
        return None
    first, upper = 360 * left / whole_x - 180, 180 * top / whole_y - 90
    return Coverage(first, first + 360 * across / whole_x, upper, upper + 180 * down / whole_y)


def as_their_like(photos: Sequence[Photo], shown: Sequence[Coverage | None]) -> list[Coverage | None]:
    """Return what photos show, where of most that have one size it was told that they show all sides: then all do.

    shown: of each photo, what `coverage_of` says; of a plain wall the pixels tell too little
    """
    sizes = Counter(photo.size for photo in photos)
    found = Counter(photo.size for photo, each in zip(photos, shown, strict=True) if each == ALL_SIDES)
    return [
        ALL_SIDES if each is None and found[photo.size] > sizes[photo.size] / 2 else each
        for photo, each in zip(photos, shown, strict=True)
    ]


def views_of(path: Path, photo: Photo, shown: Coverage) -> list[Photo]:
    """Split a panorama into views. Where it has XMP and is not tilted, gravity is known in them."""
    head = _head(path)
    return split(photo, shown, level=_PROJECTION in head and not _TILTED.search(head))


def split(photo: Photo, shown: Coverage, *, level: bool) -> list[Photo]:
    """Split a panorama into views, those of all sides from its middle on to the right. level: the camera was so."""
    focal = max(1.0, photo.size[0] / shown.across * 360 / VIEWS)
    width, height = (max(1, round(2 * focal * float(np.tan(np.radians(half))))) for half in shown.half_fields)
    view = replace(
        photo,
        size=(width, height),
        camera=f"panorama, {width} x {height} px, {focal:.0f}",
        focal_px=focal,
        turns=0,
        load_alpha=None,
        load_mask=None,
        up_in_camera=(0.0, -1.0, 0.0) if level else None,
        elevation_deg=None,
    )
    return [
        replace(
            view,
            name=f"{photo.name}@{round(turn) % 360:03d}",
            load=PhotoCopy(_View(photo.load, photo.size, (width, height), shown, focal, turn)),
        )
        for turn in shown.turns
    ]


def by_direction(panoramas: Sequence[Sequence[Photo]]) -> list[Photo]:
    """Return all views, those to one side after another: so neighbours in the list show the same places."""
    return [view for view in chain.from_iterable(zip_longest(*panoramas)) if view is not None]


@dataclass(frozen=True, slots=True)
class _View:
    """Decodes a view of a panorama of `of` pixels, so many degrees to the right of its middle: a `LoadPhoto`.

    size, focal: of the view, in pixels
    """

    whole: LoadPhoto
    of: tuple[int, int]
    size: tuple[int, int]
    shown: Coverage
    focal: float
    turn: float

    def __call__(self, longest: int | None = None) -> Bytes:
        import cv2

        share = min(1.0, (longest or max(self.size)) / max(self.size))
        width, height = (max(1, round(side * share)) for side in self.size)
        panorama = self.whole(None if share == 1 else max(1, round(max(self.of) * share)))
        rows, columns = panorama.shape[:2]
        longitude, latitude = _directions((width, height), self.focal * width / self.size[0], self.turn)
        x = (longitude - self.shown.left) / self.shown.across
        x = x % 1 * columns - 0.5 if self.shown.is_whole else np.clip(x * columns - 0.5, 0, columns - 1)
        y = (latitude - self.shown.top) / (self.shown.bottom - self.shown.top)
        row = np.clip(y * rows - 0.5, 0, rows - 1).astype(np.float32)
        return np.asarray(
            cv2.remap(panorama, x.astype(np.float32), row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP), np.uint8
        )


def _directions(size: tuple[int, int], focal: float, turn: float) -> tuple[Floats, Floats]:
    """Longitudes and latitudes downwards, in degrees, (H,W) each, of the pixels of a view of (W,H)."""
    x, y = np.meshgrid(*((np.arange(side) + 0.5 - side / 2) / focal for side in size))
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
