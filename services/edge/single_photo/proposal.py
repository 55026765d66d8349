"""Propose the thing in a photo where nothing stands out: the largest near the middle whose colours are its own.

The saliency at several levels gives candidates. GrabCut completes each within the candidate's bounding box, grown a
little; the best is the one whose colours its surroundings do not have. Twenty-eight rendered scenes chose the levels
and the weights; they are on a plateau.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import cv2
import numpy as np

from capture2vr.edge.arrays import Bools, Bytes
from capture2vr.edge.single_photo.saliency import saliency
from capture2vr.edge.single_photo.segmentation import (
    LEAST_AREA,
    grab_cut,
    has_contrast,
    inside,
    is_cut_off,
    lab_of,
    main_part,
    no_object,
)
from capture2vr.sentences.sentence import say

_OF_OTSU = (0.8, 1.0, 1.2)  # levels, of Otsu's threshold of the saliency
_LEVELS = (0.5, 0.65, 0.8)  # levels, of the highest saliency
_GROWN = 0.15  # of its sides: how far GrabCut may go beyond a candidate's bounding box
_RING = 0.25  # of the root of the area: width of the surroundings that a candidate is compared with
_COLOURS = (8.0, 10.0, 10.0)  # CIELAB: sides of the histogram's cells
_SIZE = 0.2  # exponent of the area in a candidate's merit: the larger of two alike
_OWN = 0.35  # least share of colours that the surroundings do not have; noise has 0.2, sky less, things 0.6 and more


def propose(rgb: Bytes, name: str) -> Bools:
    """Mask (h,w) of the likeliest thing. Raises CaptureError CAPTURE_NO_OBJECT where the picture shows none."""
    found = [mask for mask in _candidates(rgb) if has_contrast(rgb, mask)]
    own = [own_colours(rgb, mask) for mask in found]
    if not found or max(own) < _OWN:
        reason = say("shows_nothing_whose_colours_differ")
        raise no_object(name, reason, say("if_thing_in_draw_rectangle"))
    mask = max(zip(found, own, strict=True), key=lambda each: _merit(*each))[0]
    if is_cut_off(mask):
        raise no_object(name, say("shows_something_reaches_beyond_picture"))
    return mask


def own_colours(rgb: Bytes, mask: Bools) -> float:
    """Share of the thing's colours that the ring around it has not: half the L1 distance of their histograms."""
    cells = (lab_of(rgb) / np.array(_COLOURS, np.float32)).round().astype(int).reshape(-1, 3)
    kinds, cell = np.unique(cells, axis=0, return_inverse=True)
    cell = cell.reshape(mask.shape)
    radius = max(4, round(_RING * float(np.sqrt(mask.sum()))))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    ring = cv2.dilate(mask.astype(np.uint8), disc).astype(bool) & ~mask
    histograms = [np.bincount(cell[part], minlength=len(kinds)) / max(1, int(part.sum())) for part in (mask, ring)]
    return float(np.abs(histograms[0] - histograms[1]).sum() / 2)


def _candidates(rgb: Bytes) -> Iterator[Bools]:
    """Masks (h,w) of what may be the thing, from the saliency at several levels."""
    salient = saliency(rgb)
    otsu, _ = cv2.threshold((255 * salient).astype(np.uint8), 0, 255, cv2.THRESH_OTSU)
    for level in (*_LEVELS, *(share * float(otsu) / 255 for share in _OF_OTSU)):
        core = main_part(salient > level, most=1)
        if core.mean() < LEAST_AREA:
            continue
        mask = main_part(grab_cut(rgb, _seeds(core)), most=1)
        if mask.mean() >= LEAST_AREA:
            yield mask


def _seeds(core: Bools) -> Bytes:
    """GrabCut's initial labels: perhaps the thing in its core, perhaps not around it, and surely not farther away."""
    rows, columns = np.flatnonzero(core.any(axis=1)), np.flatnonzero(core.any(axis=0))
    down, across = (round(_GROWN * np.ptp(each)) + 3 for each in (rows, columns))
    seeds = np.full(core.shape, cv2.GC_BGD, np.uint8)
    seeds[max(0, rows[0] - down) : rows[-1] + down, max(0, columns[0] - across) : columns[-1] + across] = cv2.GC_PR_BGD
    seeds[core] = cv2.GC_PR_FGD
    seeds[~inside(core.shape)] = cv2.GC_BGD
    return seeds


def _merit(mask: Bools, own: float) -> float:
    """Merit of a candidate: its own colours first, then its size and how near it is to the middle."""
    middle = np.array(mask.shape) / 2
    centre = np.argwhere(mask).mean(axis=0)
    gap = float(np.linalg.norm((centre - middle) / middle))
    return own * own * math.pow(mask.mean(), _SIZE) * math.exp(-gap * gap / 2)
