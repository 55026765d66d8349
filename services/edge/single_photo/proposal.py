"""Propose the thing in a photo: of several masks, the one whose colours its surroundings do not have.

Before a plain background all that stands out is the thing. Otherwise candidates are what differs from the border's
colours, what is salient at three levels, and what GrabCut keeps of an ellipse in the middle; or, around a place that a
person tapped on, of discs, and of what is connected to it through similar colours. The best has colours that the ring
around it has not, a sharp outline without ragged ends, and lies near the middle. Rendered things before three photos
chose candidates and merit (`python -m tests.bench masks`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import suppress

import cv2
import numpy as np

from capture2vr.edge.arrays import Bools, Bytes
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.single_photo.plain_background import is_plain, segment_by_colour
from capture2vr.edge.single_photo.saliency import colour_way, saliency
from capture2vr.edge.single_photo.segmentation import (
    LEAST_AREA,
    ellipse,
    grab_cut,
    has_contrast,
    inside,
    is_cut_off,
    lab_of,
    main_part,
    no_object,
    outline_contrast,
    part_at,
    tidy,
)
from capture2vr.sentences.sentence import say

_LEVEL = 0.65  # of the highest saliency
_OF_OTSU = (0.8, 1.0)  # levels, of Otsu's threshold of the saliency
_MIDDLES = (0.3, 0.5)  # of half of the sides: ellipses in the middle
_DISCS = (0.1, 0.2)  # of the longer side: radius of the discs around a tap
_WAYS = (20.0, 32.0)  # CIELAB: colour steps from a tap
_TAPPED = 0.02  # of the longer side: radius of what surely belongs to the thing around a tap
_REACH = 4.5  # radii of a disc around a tap, outside of which nothing belongs to the thing
_GROWN = 0.15  # of its sides: how far GrabCut may go beyond a candidate's bounding box
_RING = 0.25  # of the root of the area: width of the surroundings that a candidate is compared with
_COLOURS = (8.0, 10.0, 10.0)  # CIELAB: sides of the histogram's cells
_RAGGED = 0.3  # exponent of the outline's compactness in a candidate's merit
_USUAL_AREA = 0.05  # share of a photo that what is photographed covers at least: less is a part of it
_OWN = 0.35  # least share of colours that the surroundings do not have; noise has 0.2, sky less, things 0.6 and more
_ALIKE = 0.85  # intersection over union of two masks of one thing


def propose(rgb: Bytes, name: str) -> tuple[Bools, bool]:
    """Mask (h,w) of the likeliest thing, and whether it stands out from a plain background.

    Raises CaptureError CAPTURE_NO_OBJECT where the picture shows none.
    """
    plain = None
    with suppress(CaptureError):
        plain = segment_by_colour(rgb, name)
    if plain is not None and is_plain(rgb):
        return plain, True
    found = [mask for mask in _candidates(rgb) if has_contrast(rgb, mask)]
    found += [] if plain is None else [plain]
    own = [own_colours(rgb, mask) for mask in found]
    if not found or max(own) < _OWN:
        reason = say("shows_nothing_whose_colours_differ")
        raise no_object(name, reason, say("if_thing_in_draw_rectangle"))
    mask = max(zip(found, own, strict=True), key=lambda each: _merit(rgb, *each))[0]
    if is_cut_off(mask):
        raise no_object(name, say("shows_something_reaches_beyond_picture"))
    return mask, plain is not None and overlap(mask, plain) > _ALIKE


def segment_at_tap(rgb: Bytes, at: tuple[int, int], name: str) -> Bools:
    """Mask (h,w) of the thing at a tapped pixel (x, y), which it contains.

    Raises CaptureError CAPTURE_NO_OBJECT where there is nothing with an outline, such as in the sky.
    """
    found = [mask for mask in _candidates_at(rgb, at) if has_contrast(rgb, mask) and not is_cut_off(mask)]
    own = [own_colours(rgb, mask) for mask in found]
    if not found or max(own) < _OWN:
        raise no_object(name, say("shows_nothing_at_tap"), say("tap_on_thing_or_draw_rectangle"))
    merits = [share**2 * outline_contrast(rgb, mask) for mask, share in zip(found, own, strict=True)]
    return found[int(np.argmax(merits))]


def own_colours(rgb: Bytes, mask: Bools) -> float:
    """Share of the thing's colours that the ring around it has not: half the L1 distance of their histograms."""
    cells = (lab_of(rgb) / np.array(_COLOURS, np.float32)).round().astype(int)
    cells -= cells.min(axis=(0, 1))
    kinds, cell = np.unique(
        np.ravel_multi_index(cells.reshape(-1, 3).T, cells.max(axis=(0, 1)) + 1), return_inverse=True
    )
    cell = cell.reshape(mask.shape)
    radius = max(4, round(_RING * float(np.sqrt(mask.sum()))))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    ring = cv2.dilate(mask.astype(np.uint8), disc).astype(bool) & ~mask
    histograms = [np.bincount(cell[part], minlength=len(kinds)) / max(1, int(part.sum())) for part in (mask, ring)]
    return float(np.abs(histograms[0] - histograms[1]).sum() / 2)


def merit(rgb: Bytes, mask: Bools) -> float:
    """How much a mask's object stands out of its picture, over 0: by what candidates are chosen."""
    return _merit(rgb, mask, own_colours(rgb, mask))


def overlap(one: Bools, other: Bools) -> float:
    """Intersection over union of two masks."""
    return float((one & other).sum() / max(1, (one | other).sum()))


def _candidates(rgb: Bytes) -> Iterator[Bools]:
    """Masks (h,w) of what may be the thing: what is salient, and what is in the middle."""
    salient = saliency(rgb)
    otsu, _ = cv2.threshold((255 * salient).astype(np.uint8), 0, 255, cv2.THRESH_OTSU)
    for level in (_LEVEL, *(share * otsu / 255 for share in _OF_OTSU)):
        core = main_part(salient > level, most=1)
        if core.mean() >= LEAST_AREA:
            yield from _grown(rgb, _seeds(core), _largest)
    middle = rgb.shape[1] // 2, rgb.shape[0] // 2
    for share in _MIDDLES:
        seeds = np.where(inside(rgb.shape[:2]), cv2.GC_PR_BGD, cv2.GC_BGD).astype(np.uint8)
        seeds[ellipse(rgb.shape[:2], middle, (share * middle[0], share * middle[1]))] = cv2.GC_PR_FGD
        yield from _grown(rgb, seeds, _largest)


def _candidates_at(rgb: Bytes, at: tuple[int, int]) -> Iterator[Bools]:
    """Masks (h,w) of what may be the thing at a pixel: of discs, and of what its colours reach."""
    shape, longer = rgb.shape[:2], max(rgb.shape[:2])
    surely = ellipse(shape, at, (_TAPPED * longer,) * 2)

    def keep(mask: Bools) -> Bools:
        return part_at(tidy(mask | surely), at)

    for share in _DISCS:
        radius = share * longer
        seeds = np.where(ellipse(shape, at, (radius,) * 2), cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
        seeds[~(inside(shape) & ellipse(shape, at, (_REACH * radius,) * 2))] = cv2.GC_BGD
        seeds[surely] = cv2.GC_FGD
        yield from _grown(rgb, seeds, keep)
    way = colour_way(rgb, at)
    for most in _WAYS:
        seeds = _seeds((way <= most) | surely)
        seeds[surely] = cv2.GC_FGD
        yield from _grown(rgb, seeds, keep)


def _grown(rgb: Bytes, seeds: Bytes, keep: Callable[[Bools], Bools]) -> Iterator[Bools]:
    """What GrabCut makes of seeds, unless that is nothing, or there is no background."""
    if (seeds == cv2.GC_BGD).any():
        mask = keep(grab_cut(rgb, seeds))
        if mask.mean() >= LEAST_AREA:
            yield mask


def _largest(mask: Bools) -> Bools:
    return main_part(mask, most=1)


def _seeds(core: Bools) -> Bytes:
    """GrabCut's initial labels: perhaps the thing in its core, perhaps not around it, and surely not farther away."""
    rows, columns = np.flatnonzero(core.any(axis=1)), np.flatnonzero(core.any(axis=0))
    down, across = (round(_GROWN * np.ptp(each)) + 3 for each in (rows, columns))
    seeds = np.full(core.shape, cv2.GC_BGD, np.uint8)
    seeds[max(0, rows[0] - down) : rows[-1] + down, max(0, columns[0] - across) : columns[-1] + across] = cv2.GC_PR_BGD
    seeds[core] = cv2.GC_PR_FGD
    seeds[~inside(core.shape)] = cv2.GC_BGD
    return seeds


def _merit(rgb: Bytes, mask: Bools, own: float) -> float:
    """Merit of a candidate: its own colours first, then its outline, how near it is to the middle, and its size."""
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    corners = max(1, sum(map(len, contours)))
    compact = 4 * math.pi * float(mask.sum()) / corners**2
    middle = np.array(mask.shape) / 2
    gap = float(np.linalg.norm((np.argwhere(mask).mean(axis=0) - middle) / middle))
    whole = min(1.0, float(mask.mean()) / _USUAL_AREA)
    return math.pow(own, 4) * outline_contrast(rgb, mask) * math.pow(compact, _RAGGED) * math.exp(-gap * gap) * whole
