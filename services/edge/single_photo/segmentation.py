"""What the ways of segmenting a photo share: GrabCut, the main part of a mask, and when a mask is no thing. OpenCV."""

from __future__ import annotations

import cv2
import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats
from capture2vr.edge.errors import CaptureError
from capture2vr.sentences.sentence import say

MOST_AREA = 0.92
"""Most share of the picture that a thing covers."""
LEAST_AREA = 0.005
"""Least share of the picture that a thing covers."""
_BORDER = 0.04  # of the longer side: width of the border, which is taken for background
_ROUNDS = 5  # of GrabCut
_LIGHTNESS = 0.6  # weight of lightness in a distance: shadows are darker than their ground and of the same colour
_OUTLINE = 1.2  # least contrast of an outline, CIELAB per pixel; things have 4 and more, lens vignetting has none
_EDGE = 0.25  # share of a side of the picture that a thing which is cut off there covers at least
_APART = 0.2  # of the best component's merit: components below it do not belong to the thing
_ADVICE = (
    say("take_photo_so_whole_thing"),
    say("choose_background_another_colour_than"),
)


def grab_cut(rgb: Bytes, seeds: Bytes) -> Bools:
    """Segment by GrabCut (Rother et al. 2004) from initial labels (h,w), of which some must be background."""
    cv2.setRNGSeed(0)  # GrabCut draws its first colour clusters
    models = np.zeros((1, 65)), np.zeros((1, 65))
    unused = (0, 0, 0, 0)  # the rectangle: the seeds take its place
    bgr = np.ascontiguousarray(rgb[..., ::-1])
    labels, _, _ = cv2.grabCut(bgr, seeds.copy(), unused, *models, _ROUNDS, cv2.GC_INIT_WITH_MASK)
    return np.asarray((labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD))


def main_part(mask: Bools, *, most: int | None = None) -> Bools:
    """Keep the components that are large and near the middle, without specks and holes of a few pixels.

    most  greatest number of them; None: any
    """
    count, labels, stats, centres = cv2.connectedComponentsWithStats(tidy(mask).astype(np.uint8))
    if count < 2:
        return np.zeros_like(mask)
    middle = np.array(mask.shape[::-1]) / 2
    gap = np.linalg.norm((centres[1:] - middle) / middle, axis=1)
    merit = stats[1:, cv2.CC_STAT_AREA] * np.exp(-2 * gap * gap)
    best = np.argsort(-merit)[:most]
    return np.isin(labels, best[merit[best] > _APART * merit.max()] + 1)


def tidy(mask: Bools) -> Bools:
    """Remove specks and holes of a pixel or two."""
    kernel = np.ones((3, 3), np.uint8)
    opened = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, kernel)
    return np.asarray(cv2.morphologyEx(opened, cv2.MORPH_CLOSE, kernel) > 0)


def part_at(mask: Bools, at: tuple[int, int]) -> Bools:
    """The component of a mask that contains a pixel (x, y); empty where the mask does not have it."""
    _, labels = cv2.connectedComponents(mask.astype(np.uint8))
    number = labels[at[1], at[0]]
    return np.asarray((labels == number) & (number > 0))


def ellipse(shape: tuple[int, ...], middle: tuple[int, int], half: tuple[float, float]) -> Bools:
    """Mask (h,w) of an ellipse around a pixel (x, y), by half of its width and height in pixels."""
    drawn = np.zeros(shape, np.uint8)
    axes = max(1, round(half[0])), max(1, round(half[1]))
    cv2.ellipse(drawn, middle, axes, 0, 0, 360, 1, cv2.FILLED)
    return drawn > 0


def lab_of(rgb: Bytes) -> Floats:
    """Convert to CIELAB (h,w,3), blurred against noise, lightness scaled by `_LIGHTNESS`."""
    lab = cv2.cvtColor(cv2.GaussianBlur(rgb, (0, 0), 1.5).astype(np.float32) / 255, cv2.COLOR_RGB2LAB)
    return np.asarray(lab * np.array([_LIGHTNESS, 1, 1], np.float32))


def inside(shape: tuple[int, ...]) -> Bools:
    """Mask (h,w), False along the border."""
    band = max(2, round(_BORDER * max(shape)))
    within = np.zeros(shape, bool)
    within[band:-band, band:-band] = True
    return within


def outline_contrast(rgb: Bytes, mask: Bools) -> float:
    """Median change of colour across the mask's outline, in CIELAB per pixel; 0 where it has none."""
    lab = lab_of(rgb)
    across, down = (cv2.Sobel(lab, cv2.CV_32F, *axis, scale=1 / 8) for axis in ((1, 0), (0, 1)))
    steep = np.sqrt((across * across + down * down).sum(axis=2))
    kernel = np.ones((3, 3), np.uint8)
    outline = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_GRADIENT, kernel).astype(bool) & inside(mask.shape)
    return float(np.median(steep[outline])) if outline.any() else 0.0


def has_contrast(rgb: Bytes, mask: Bools) -> bool:
    """Whether the colours change across the mask's outline."""
    return outline_contrast(rgb, mask) >= _OUTLINE


def is_cut_off(mask: Bools) -> bool:
    """Whether the mask fills the picture, or reaches beyond it on every side."""
    sides = mask[0].mean(), mask[-1].mean(), mask[:, 0].mean(), mask[:, -1].mean()
    return bool(mask.mean() > MOST_AREA or all(side > _EDGE for side in sides))


def no_object(name: str, reason: str, *advice: str) -> CaptureError:
    """The error for a photo `name` without a thing that can be cut out; `advice` comes before the usual."""
    return CaptureError("CAPTURE_NO_OBJECT", reason, file=name, hints=(*advice, *_ADVICE))
