"""Make a printed relief of the thing in one photo: its outline inflated, the photo printed on the front. It is a guess.

The relief is symmetric about a plane, in which its outline lies, and closed, but for a garment: that is two sheets that
end side by side at neck, sleeves and hem. Its front as seen by the photo's camera is the photo to the pixel; how thick
it is follows from the kind of its outline alone.
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
from capture2vr.edge.single_photo.membrane import Membrane, closed_mesh, inflate
from capture2vr.edge.single_photo.outline_kind import OutlineKind, inflation_of
from capture2vr.edge.single_photo.photo_window import DISTANCE, GRID, SIDE, PhotoWindow
from capture2vr.edge.single_photo.printed_views import PrintedPicture, printed_pictures
from capture2vr.order.photo_box import PhotoBox

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
    models learned models that cut it out
    """

    xyz: Floats
    rgb: Bytes
    views: tuple[TextureView, TextureView]
    kind: OutlineKind
    mask: Bools
    closed: bool
    warnings: tuple[str, ...] = ()
    models: tuple[UsedModel, ...] = ()


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
    cut = cut_out(photo, box, models, part_of(tick, 0.0, 0.5))
    tick(0.5)
    window = PhotoWindow.around(photo, cut.bounds())
    mask = window.mask_of(cut, SIDE)
    kind, inflation = inflation_of(mask)
    beyond = open_ends(mask, _BEYOND) if kind == "garment" else np.zeros_like(mask)
    membrane = inflate(mask | beyond, inflation)
    surface = closed_mesh(membrane).vertices
    surface = surface[~_in(_cut_away(mask, beyond), surface)]
    membrane = replace(membrane, squared=np.where(beyond, -1.0, membrane.squared))
    tick(0.7)
    views = _views(
        printed_pictures(window.load(photo, _PRINT_PX), window.mask_of(cut, _PRINTED * SIDE)), membrane, photo.name
    )
    rgb = _colours(surface, views)
    tick(1.0)
    return Relief(
        _as_seen(surface) / GRID, rgb, views, kind, mask, not beyond.any(), warnings=cut.warnings, models=cut.models
    )


def _cut_away(mask: Bools, beyond: Bools) -> Bools:
    """Mask (h,w) of what goes on behind a garment's openings, and of the rounded edge beside that."""
    beside, grown = (
        cv2.dilate(each.astype(np.uint8), np.ones((side, side))) > 0 for each, side in ((beyond, 9), (mask, 3))
    )
    return np.asarray(beyond | (beside & ~grown))


def _in(mask: Bools, surface: Floats) -> Bools:
    """Which places (N,3) in pixels lie over a mask (h,w)."""
    at = np.stack([surface[:, 0], -surface[:, 1]], axis=1) / SIDE + 0.5
    return np.asarray(bilinear((255 * mask[..., None]).astype(np.uint8), at)[:, 0] > 127)


def _as_seen(surface: Floats) -> Floats:
    """Move places (N,3) in pixels so that the camera of their side sees each in the pixel that it was made from."""
    nearer = 1 - np.abs(surface[:, 2:]) / (DISTANCE * GRID)
    return np.concatenate([surface[:, :2] * nearer, surface[:, 2:]], axis=1)


def _views(pictures: tuple[PrintedPicture, ...], membrane: Membrane, name: str) -> tuple[TextureView, TextureView]:
    """Both pictures with their cameras and depth."""
    focal, middle = DISTANCE * GRID, (SIDE - 1) / 2
    camera = Intrinsics(focal, focal, middle, middle, SIDE, SIDE)
    depth = np.where(membrane.squared > 0, DISTANCE - membrane.height / GRID, 0).astype(np.float32)
    front, back = np.diag([1.0, -1, -1, 1]), np.diag([-1.0, -1, 1, 1])
    front[2, 3], back[2, 3] = DISTANCE, -DISTANCE
    return (
        TextureView(camera, front, pictures[0], depth.copy, name),
        TextureView(camera, back, pictures[1], np.ascontiguousarray(depth[:, ::-1]).copy, _BACK.format(name)),
    )


def _colours(surface: Floats, views: tuple[TextureView, TextureView]) -> Bytes:
    """Colours (N,3) of places in pixels, from the picture of their side."""
    at = np.stack([surface[:, 0], -surface[:, 1]], axis=1) / SIDE
    front = bilinear(views[0].load_rgb(), at + 0.5)
    back = bilinear(views[1].load_rgb(), at * [-1, 1] + 0.5)
    return np.asarray(np.where(surface[:, 2:] >= 0, front, back).round(), np.uint8)
