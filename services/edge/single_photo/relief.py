"""Make a printed relief of the thing in one photo: its outline inflated, the photo printed on the front. It is a guess.

The relief is closed, and its outline lies in a plane. Its front as seen by the photo's camera is the photo to the
pixel; how thick it is follows from the kind of its outline alone. About that plane it is symmetric, but for a front
whose height a learned model tells.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats, Tick, part_of
from capture2vr.edge.capture.nouns import Intrinsics, Photo
from capture2vr.edge.models.folder import ModelFolder
from capture2vr.edge.models.nouns import LearnedView, UsedModel
from capture2vr.edge.points.nouns import TextureView
from capture2vr.edge.render.sample_image import bilinear
from capture2vr.edge.single_photo.cutout import CutOut, Tap, cut_out, rotate_clockwise
from capture2vr.edge.single_photo.learned_cut import DIGITS
from capture2vr.edge.single_photo.learned_depth import LearnedDepth, learned_depth, unsure
from capture2vr.edge.single_photo.learned_front import learned_front
from capture2vr.edge.single_photo.membrane import Membrane, closed_mesh, inflate
from capture2vr.edge.single_photo.outline_kind import OutlineKind, inflation_of
from capture2vr.edge.single_photo.printed_views import PrintedPicture, printed_pictures
from capture2vr.order.photo_box import PhotoBox
from capture2vr.sentences.sentence import say

GRID = 150
"""Pixels along the longer side of the mask that is inflated."""
_PRINT_PX = 2048
"""Most pixels along the longer side of the printed pictures: as many as the largest texture has."""
SIDE = 186
"""Pixels along the sides of the square around it: textures take little from a picture's outer 6 %."""
_PRINTED = 2
"""Times finer is the mask of the printed pictures."""
_BACK = "{} (back)"
_DISTANCE = 4.0
"""Distance of the camera, in longer sides of the relief: nobody knows it, and from far away outlines stay true."""
MOST_CONFIDENT = 0.2
"""The confidence of a guessed point, of 1: nothing was measured."""


@dataclass(frozen=True, slots=True)
class Relief:
    """Points of a relief in a frame of its own: y up, the camera on the side of +z, its middle plane z = 0, the longer
    side of its outline 1.

    xyz    (N,3) float64, evenly spaced; rgb (N,3) uint8 sRGB, of the printed pictures
    views  the two pictures with their cameras: the front, and the back
    kind   what its thickness follows from; mask (h,w): what was inflated
    models learned models that cut it out, or tell its depth
    metres of its unit, as a learned model estimates it, whose title is `sized_by`; None: nobody does
    """

    xyz: Floats
    rgb: Bytes
    views: tuple[TextureView, TextureView]
    kind: OutlineKind
    mask: Bools
    warnings: tuple[str, ...] = ()
    models: tuple[UsedModel, ...] = ()
    metres: float | None = None
    sized_by: str = ""


def make_relief(
    photo: Photo,
    *,
    box: PhotoBox | None = None,
    tap: Tap | None = None,
    models: ModelFolder | None = None,
    tick: Tick,
) -> Relief:
    """Make the relief of the thing in a photo, in a rectangle of it, or at a tap.

    Raises CaptureError CAPTURE_NO_OBJECT, and whatever loading the photo raises.
    """
    tick(0.0)
    cut = cut_out(photo, box, tap, models, part_of(tick, 0.0, 0.3))
    tick(0.3)
    window = _Window.around(photo, cut.bounds())
    mask = window.mask_of(cut, SIDE)
    kind, inflation = inflation_of(mask)
    learned = learned_depth(models, photo, part_of(tick, 0.3, 0.6))
    membrane, told = _with_front(inflate(mask, inflation), mask, window, learned, photo.name)
    tick(0.6)
    surface = closed_mesh(membrane).vertices
    tick(0.7)
    views = _views(printed_pictures(window.load(photo), window.mask_of(cut, _PRINTED * SIDE)), membrane, photo.name)
    rgb = _colours(surface, views)
    tick(1.0)
    warnings, models_used = cut.warnings + told.warnings, cut.models + told.models
    return Relief(_as_seen(surface) / GRID, rgb, views, kind, mask, warnings, models_used, told.metres, told.sized_by)


@dataclass(frozen=True, slots=True)
class _Told:
    """What a model's depth adds to a relief, beside its shape: as in `Relief`."""

    warnings: tuple[str, ...] = ()
    models: tuple[UsedModel, ...] = ()
    metres: float | None = None
    sized_by: str = ""


def _with_front(
    membrane: Membrane, mask: Bools, window: _Window, learned: LearnedDepth, name: str
) -> tuple[Membrane, _Told]:
    """Give a membrane the front that a model's depth tells, where it tells one."""
    if learned.view is None or learned.graph is None:
        return membrane, _Told(learned.warnings)
    front = learned_front(*window.depth_of(learned.view, SIDE), mask, membrane)
    if front is None:
        return membrane, _Told((unsure(learned.graph, name),))
    used, title = learned.graph.used, learned.graph.card.title
    warning = say("front_by_model", name=name, model=title, version=used.sha256[:DIGITS])
    return replace(membrane, ratio=front.ratio), _Told((warning,), (used,), front.pixel_m * GRID, title)


@dataclass(frozen=True, slots=True)
class _Window:
    """The square part of an upright photo that is printed: the thing and a margin, which may lie beyond the photo.

    left, top, side  whole pixels of the upright photo; width, height: all of the photo's
    """

    left: int
    top: int
    side: int
    width: int
    height: int

    @classmethod
    def around(cls, photo: Photo, bounds: PhotoBox) -> _Window:
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

    def load(self, photo: Photo) -> Bytes:
        """Load what the photo shows of it, at most `_PRINT_PX` pixels long; its edge's pixels where the photo ends."""
        side = min(self.side, _PRINT_PX)
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


def _as_seen(surface: Floats) -> Floats:
    """Move places (N,3) in pixels so that the camera of their side sees each in the pixel that it was made from."""
    nearer = 1 - np.abs(surface[:, 2:]) / (_DISTANCE * GRID)
    return np.concatenate([surface[:, :2] * nearer, surface[:, 2:]], axis=1)


def _views(pictures: tuple[PrintedPicture, ...], membrane: Membrane, name: str) -> tuple[TextureView, TextureView]:
    """Both pictures with their cameras and depth."""
    focal, middle = _DISTANCE * GRID, (SIDE - 1) / 2
    camera = Intrinsics(focal, focal, middle, middle, SIDE, SIDE)
    near, far = (
        np.where(membrane.squared > 0, _DISTANCE - height / GRID, 0).astype(np.float32)
        for height in (membrane.front, membrane.height)
    )
    front, back = np.diag([1.0, -1, -1, 1]), np.diag([-1.0, -1, 1, 1])
    front[2, 3], back[2, 3] = _DISTANCE, -_DISTANCE
    return (
        TextureView(camera, front, pictures[0], near.copy, name),
        TextureView(camera, back, pictures[1], np.ascontiguousarray(far[:, ::-1]).copy, _BACK.format(name)),
    )


def _colours(surface: Floats, views: tuple[TextureView, TextureView]) -> Bytes:
    """Colours (N,3) of places in pixels, from the picture of their side."""
    at = np.stack([surface[:, 0], -surface[:, 1]], axis=1) / SIDE
    front = bilinear(views[0].load_rgb(), at + 0.5)
    back = bilinear(views[1].load_rgb(), at * [-1, 1] + 0.5)
    return np.asarray(np.where(surface[:, 2:] >= 0, front, back).round(), np.uint8)
