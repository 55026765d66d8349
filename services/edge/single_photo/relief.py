"""Make a printed relief of the thing in one photo: its outline inflated, the photo printed on the front. It is a guess.

The relief is closed, but for a garment: that is two sheets that end side by side at neck, sleeves and hem. Its outline
lies in a plane, and its front as seen by the photo's camera is the photo to the pixel; how thick it is follows from the
kind of its outline alone. About that plane it is symmetric, but for a front whose height a learned model tells.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats, Tick, part_of
from capture2vr.edge.capture.nouns import Intrinsics, Photo
from capture2vr.edge.models.folder import ModelFolder
from capture2vr.edge.models.nouns import UsedModel
from capture2vr.edge.points.nouns import TextureView
from capture2vr.edge.render.sample_image import bilinear
from capture2vr.edge.single_photo.cutout import cut_out
from capture2vr.edge.single_photo.garment import open_ends
from capture2vr.edge.single_photo.learned_cut import DIGITS
from capture2vr.edge.single_photo.learned_depth import LearnedDepth, learned_depth, unsure
from capture2vr.edge.single_photo.learned_front import learned_front
from capture2vr.edge.single_photo.membrane import Membrane, closed_mesh, inflate
from capture2vr.edge.single_photo.outline_kind import OutlineKind, inflation_of
from capture2vr.edge.single_photo.photo_window import DISTANCE, GRID, SIDE, PhotoWindow
from capture2vr.edge.single_photo.printed_views import PrintedPicture, printed_pictures
from capture2vr.order.photo_box import PhotoBox
from capture2vr.sentences.sentence import say

_PRINT_PX = 2048
"""Most pixels along the longer side of the printed pictures: as many as the largest texture has."""
_BEYOND = 14.0
"""Pixels that a garment's sheets go on beyond its openings before they are cut: there their edge is not rounded."""
_PRINTED = 2
"""Times finer is the mask of the printed pictures."""
_BACK = "{} (back)"
MOST_CONFIDENT = 0.2
"""The confidence of a guessed point, of 1: nothing was measured."""


@dataclass(frozen=True, slots=True)
class Relief:
    """Points of a relief in a frame of its own: y up, the camera on the side of +z, its middle plane z = 0, the longer
    side of its outline 1.

    xyz    (N,3) float64, evenly spaced; rgb (N,3) uint8 sRGB, of the printed pictures
    views  the two pictures with their cameras: the front, and the back
    kind   what its thickness follows from; mask (h,w): what was inflated
    closed whether it has no opening
    models learned models that cut it out, or tell its depth
    metres of its unit, as a learned model estimates it, whose title is `sized_by`; None: nobody does
    """

    xyz: Floats
    rgb: Bytes
    views: tuple[TextureView, TextureView]
    kind: OutlineKind
    mask: Bools
    closed: bool
    warnings: tuple[str, ...] = ()
    models: tuple[UsedModel, ...] = ()
    metres: float | None = None
    sized_by: str = ""


def make_relief(
    photo: Photo,
    *,
    box: PhotoBox | None = None,
    models: ModelFolder | None = None,
    tick: Tick,
) -> Relief:
    """Make the relief of the thing in a photo, or of what a person marked in it.

    Raises CaptureError CAPTURE_NO_OBJECT, and whatever loading the photo raises.
    """
    tick(0.0)
    cut = cut_out(photo, box, models, part_of(tick, 0.0, 0.3))
    tick(0.3)
    window = PhotoWindow.around(photo, cut.bounds())
    mask = window.mask_of(cut, SIDE)
    kind, inflation = inflation_of(mask)
    beyond = open_ends(mask, _BEYOND) if kind == "garment" else np.zeros_like(mask)
    learned = learned_depth(models, photo, part_of(tick, 0.3, 0.6))
    membrane, told = _with_front(inflate(mask | beyond, inflation), mask, window, learned, photo.name)
    tick(0.6)
    surface = closed_mesh(membrane).vertices
    surface = surface[~_in(_cut_away(mask, beyond), surface)]
    membrane = replace(membrane, squared=np.where(beyond, -1.0, membrane.squared))
    tick(0.7)
    views = _views(
        printed_pictures(window.load(photo, _PRINT_PX), window.mask_of(cut, _PRINTED * SIDE)), membrane, photo.name
    )
    rgb = _colours(surface, views)
    tick(1.0)
    warnings, models_used = cut.warnings + told.warnings, cut.models + told.models
    closed = not beyond.any()
    return Relief(
        _as_seen(surface) / GRID, rgb, views, kind, mask, closed, warnings, models_used, told.metres, told.sized_by
    )


@dataclass(frozen=True, slots=True)
class _Told:
    """What a model's depth adds to a relief, beside its shape: as in `Relief`."""

    warnings: tuple[str, ...] = ()
    models: tuple[UsedModel, ...] = ()
    metres: float | None = None
    sized_by: str = ""


def _with_front(
    membrane: Membrane, mask: Bools, window: PhotoWindow, learned: LearnedDepth, name: str
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


def _cut_away(mask: Bools, beyond: Bools) -> Bools:
    """Mask (h,w) of what goes on behind a garment's openings, and of the rounded edge beside that."""
    beside, grown = (
        cv2.dilate(each.astype(np.uint8), np.ones((side, side))) > 0 for each, side in ((beyond, 9), (mask, 3))
    )
    return np.asarray(beyond | (beside & ~grown))


def _in(mask: Bools, surface: Floats) -> Bools:
    """Which places (N,3) in pixels lie over a mask (h,w)."""
    shown = bilinear((255 * mask[..., None]).astype(np.uint8), _from_middle(surface) + 0.5)
    return np.asarray(shown[:, 0] > 127)


def _from_middle(surface: Floats) -> Floats:
    """Where places (N,3) in pixels are from the middle of the front's picture (N,2), right and down, in its sides."""
    return np.stack([surface[:, 0], -surface[:, 1]], axis=1) / SIDE


def _as_seen(surface: Floats) -> Floats:
    """Move places (N,3) in pixels so that the camera of their side sees each in the pixel that it was made from."""
    nearer = 1 - np.abs(surface[:, 2:]) / (DISTANCE * GRID)
    return np.concatenate([surface[:, :2] * nearer, surface[:, 2:]], axis=1)


def _views(pictures: tuple[PrintedPicture, ...], membrane: Membrane, name: str) -> tuple[TextureView, TextureView]:
    """Both pictures with their cameras and depth."""
    focal, middle = DISTANCE * GRID, (SIDE - 1) / 2
    camera = Intrinsics(focal, focal, middle, middle, SIDE, SIDE)
    near, far = (
        np.where(membrane.squared > 0, DISTANCE - height / GRID, 0).astype(np.float32)
        for height in (membrane.front, membrane.height)
    )
    front, back = np.diag([1.0, -1, -1, 1]), np.diag([-1.0, -1, 1, 1])
    front[2, 3], back[2, 3] = DISTANCE, -DISTANCE
    return (
        TextureView(camera, front, pictures[0], near.copy, name),
        TextureView(camera, back, pictures[1], np.ascontiguousarray(far[:, ::-1]).copy, _BACK.format(name)),
    )


def _colours(surface: Floats, views: tuple[TextureView, TextureView]) -> Bytes:
    """Colours (N,3) of places in pixels, from the picture of their side."""
    at = _from_middle(surface)
    front = bilinear(views[0].load_rgb(), at + 0.5)
    back = bilinear(views[1].load_rgb(), at * [-1, 1] + 0.5)
    return np.asarray(np.where(surface[:, 2:] >= 0, front, back).round(), np.uint8)
