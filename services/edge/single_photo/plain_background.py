"""Segment the thing in a photo before a plain background: GrabCut, started from what differs from the colours along the
picture's border and lies near its middle. numpy and OpenCV."""

from __future__ import annotations

import cv2
import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats
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

_BORDER_COLOURS = 4  # clusters of k-means
_SURELY, _PERHAPS = 2.5, 1.2  # `_strangeness` above which a pixel is surely, or perhaps, the thing
_PLAIN_LAB = 1.5  # CIELAB: most spread of a plain border's colours about their clusters; carpets have 1.6 and more
_LEAST_LAB = 7.0  # least spread, in CIELAB: lamps and lenses make as much of one wall


def segment_by_colour(rgb: Bytes, name: str) -> Bools:
    """Mask (h,w) of what differs in colour from the border. Raises CaptureError CAPTURE_NO_OBJECT."""
    strange = _strangeness(rgb)
    seeds = _seeds(strange)
    if seeds is None:
        raise no_object(name, say("shows_nothing_stands"))
    mask = main_part(grab_cut(rgb, seeds))
    if mask.mean() < LEAST_AREA:
        raise no_object(name, say("shows_nothing_stands"))
    if float(np.median(strange[mask])) < _PERHAPS or not has_contrast(rgb, mask):
        raise no_object(name, say("shows_nothing_whose_colours_differ"))
    if is_cut_off(mask):
        raise no_object(name, say("shows_something_reaches_beyond_picture"))
    return mask


def _strangeness(rgb: Bytes) -> Floats:
    """Distance (h,w) of each pixel's colour from the colours along the border, in units of their usual spread."""
    lab = lab_of(rgb)
    centres, rms = _border_colours(lab)
    spread = max(_LEAST_LAB, 2 * rms)
    away = np.min([np.sqrt(((lab - centre) ** 2).sum(axis=2)) for centre in centres], axis=0)
    return np.asarray(away / spread)


def is_plain(rgb: Bytes) -> bool:
    """Whether a picture's border has a few colours alone: then all that differs from them is the thing."""
    return _border_colours(lab_of(rgb))[1] < _PLAIN_LAB


def _border_colours(lab: Floats) -> tuple[Floats, float]:
    """Means (4,3) of the clusters of the border's colours, and how far these are from their cluster's: the root mean
    square, in CIELAB."""
    border = lab[~inside(lab.shape[:2])]
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 20, 0.5)
    cv2.setRNGSeed(0)
    unlabelled = np.zeros((len(border), 1), np.int32)
    compactness, _, centres = cv2.kmeans(border, _BORDER_COLOURS, unlabelled, criteria, 3, cv2.KMEANS_PP_CENTERS)
    return np.asarray(centres), float(np.sqrt(compactness / len(border)))


def _seeds(strange: Floats) -> Bytes | None:
    """GrabCut's initial labels; None where nothing differs from the border. Near the middle a smaller one counts."""
    h, w = strange.shape
    y, x = np.mgrid[-1 : 1 : complex(h), -1 : 1 : complex(w)]
    from_middle = np.sqrt(x * x + y * y)
    strange = strange * np.clip(1.3 - 0.5 * from_middle, 0, 1)
    seeds = np.where(strange > _PERHAPS, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    seeds[~inside(strange.shape) & (strange < _PERHAPS)] = cv2.GC_BGD
    if (strange > _SURELY).mean() < LEAST_AREA / 2 or not (seeds == cv2.GC_BGD).any():
        return None
    return seeds
