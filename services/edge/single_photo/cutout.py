"""Segment the thing in a photo, and crop the square around it that the network sees. numpy and OpenCV.

The mask is an alpha channel, where there is one; otherwise GrabCut computes it (Rother et al. 2004), started from what
differs from the colours along the picture's border and lies near its middle.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from services.edge.arrays import Bools, Bytes, Floats
from services.edge.capture.nouns import Photo
from services.edge.errors import CaptureError

LONGEST = 320
"""Longest side in pixels of the picture that is segmented: GrabCut takes 0.2 s, and the network sees only 64."""
_BORDER = 0.04  # of the longer side: width of the border, which is taken for background
_BORDER_COLOURS = 4  # clusters of k-means
_ROUNDS = 5  # of GrabCut
_SURELY, _PERHAPS = 2.5, 1.2  # `_strangeness` above which a pixel is surely, or perhaps, the thing
_LEAST_LAB = 7.0  # least spread, in CIELAB: lamps and lenses make as much of one wall
_LIGHTNESS = 0.6  # weight of lightness in a distance: shadows are darker than their ground and of the same colour
_OUTLINE = 1.2  # least contrast of an outline, CIELAB per pixel; things have 4 and more, lens vignetting has none
_AREA = (0.005, 0.92)  # least and most share of the picture that a thing covers
_EDGE = 0.25  # share of a side of the picture that a thing which is cut off there covers at least
_OPAQUE = 128  # alpha from which on a pixel belongs to the thing
_ADVICE = (
    "take the photo so that the whole thing is in it, with some background on every side",
    "choose a background of another colour than the thing, in even light",
)


@dataclass(frozen=True, slots=True)
class CutOut:
    """A segmented photo: rgb (h,w,3) uint8 upright, and mask (h,w) of the thing."""

    rgb: Bytes
    mask: Bools


def cut_out(photo: Photo) -> CutOut:
    """Segment the thing in a photo: by its alpha channel, if that hides anything, else by colour.

    Raises CaptureError CAPTURE_NO_OBJECT where nothing stands out, or what does is cut off on every side.
    """
    stored = photo.load(LONGEST)
    alpha = photo.load_alpha() if photo.load_alpha else None
    rgb = rotate_clockwise(stored, photo.turns)
    if alpha is None or not 0 < (alpha >= _OPAQUE).mean() < 1:
        return CutOut(rgb, segment_by_colour(rgb, photo.name))
    height, width = stored.shape[:2]
    small = np.asarray(cv2.resize(alpha, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    return CutOut(rgb, rotate_clockwise(small, photo.turns) >= _OPAQUE)


def rotate_clockwise(pixels: Bytes, turns: int) -> Bytes:
    """Rotate pixels clockwise by so many quarter turns."""
    return np.ascontiguousarray(np.rot90(pixels, -turns))


def segment_by_colour(rgb: Bytes, name: str) -> Bools:
    """Mask (h,w) of what differs in colour from the border. Raises CaptureError CAPTURE_NO_OBJECT."""
    strange = _strangeness(rgb)
    seeds = _seeds(strange)
    if seeds is None:
        raise _no_object(name, "shows nothing that stands out from its background")
    cv2.setRNGSeed(0)  # GrabCut draws its first colour clusters
    models = np.zeros((1, 65)), np.zeros((1, 65))
    unused = (0, 0, 0, 0)  # the rectangle: the seeds take its place
    labels, _, _ = cv2.grabCut(rgb[..., ::-1].copy(), seeds, unused, *models, _ROUNDS, cv2.GC_INIT_WITH_MASK)
    mask = _main_part((labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD))
    _check(mask, strange, rgb, name)
    return mask


def crop_square(cut: CutOut, side: int, fill: float, *, shift: tuple[float, float] = (0.0, 0.0)) -> Floats:
    """Crop a square around the thing -> (side,side,4) float32 in [0,1]: colours times mask, and mask.

    The thing's longer side takes `fill` of the square; its middle lies `shift` squares right of and below the square's.
    """
    rows, columns = np.flatnonzero(cut.mask.any(axis=1)), np.flatnonzero(cut.mask.any(axis=0))
    top, bottom, left, right = rows[0], rows[-1] + 1, columns[0], columns[-1] + 1
    length = max(bottom - top, right - left) / fill
    x0 = (left + right) / 2 - length * (0.5 + shift[0])
    y0 = (top + bottom) / 2 - length * (0.5 + shift[1])
    # Where the photo is finer than the square, warp to a multiple of the square's size, then average. Pixel i lies at
    # x0 + (i + ½)·by − ½ of the photo.
    fine = side * max(1, int(np.ceil(length / side)))
    by = length / fine
    warp = np.array([[by, 0, x0 + by / 2 - 0.5], [0, by, y0 + by / 2 - 0.5]])
    mask = cut.mask[..., None].astype(np.float32)
    layers = np.concatenate([cut.rgb / np.float32(255) * mask, mask], axis=2)
    drawn = cv2.warpAffine(layers, warp, (fine, fine), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    return np.asarray(cv2.resize(drawn, (side, side), interpolation=cv2.INTER_AREA), np.float32)


def _strangeness(rgb: Bytes) -> Floats:
    """Distance (h,w) of each pixel's colour from the colours along the border, in units of their usual spread."""
    lab = _lab(rgb)
    border = lab[~_inside(lab.shape[:2])]
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 20, 0.5)
    cv2.setRNGSeed(0)
    unlabelled = np.zeros((len(border), 1), np.int32)
    compactness, _, centres = cv2.kmeans(border, _BORDER_COLOURS, unlabelled, criteria, 3, cv2.KMEANS_PP_CENTERS)
    spread = max(_LEAST_LAB, 2 * float(np.sqrt(compactness / len(border))))
    away = np.min([np.sqrt(((lab - centre) ** 2).sum(axis=2)) for centre in centres], axis=0)
    return np.asarray(away / spread)


def _lab(rgb: Bytes) -> Floats:
    """Convert to CIELAB (h,w,3), blurred against noise, lightness scaled by `_LIGHTNESS`."""
    lab = cv2.cvtColor(cv2.GaussianBlur(rgb, (0, 0), 1.5).astype(np.float32) / 255, cv2.COLOR_RGB2LAB)
    return np.asarray(lab * np.array([_LIGHTNESS, 1, 1], np.float32))


def _inside(shape: tuple[int, ...]) -> Bools:
    """Mask (h,w), False along the border."""
    band = max(2, round(_BORDER * max(shape)))
    inside = np.zeros(shape, bool)
    inside[band:-band, band:-band] = True
    return inside


def _seeds(strange: Floats) -> Bytes | None:
    """GrabCut's initial labels; None where nothing differs from the border. Near the middle a smaller one counts."""
    h, w = strange.shape
    y, x = np.mgrid[-1 : 1 : complex(h), -1 : 1 : complex(w)]
    from_middle = np.sqrt(x * x + y * y)
    strange = strange * np.clip(1.3 - 0.5 * from_middle, 0, 1)
    seeds = np.where(strange > _PERHAPS, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    seeds[~_inside(strange.shape) & (strange < _PERHAPS)] = cv2.GC_BGD
    if (strange > _SURELY).mean() < _AREA[0] / 2 or not (seeds == cv2.GC_BGD).any():
        return None
    return seeds


def _main_part(mask: Bools) -> Bools:
    """Keep the components that are large and near the middle, without specks and holes of a few pixels."""
    kernel = np.ones((3, 3), np.uint8)
    tidy = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, kernel)
    tidy = cv2.morphologyEx(tidy, cv2.MORPH_CLOSE, kernel)
    count, labels, stats, centres = cv2.connectedComponentsWithStats(tidy)
    if count < 2:
        return np.zeros_like(mask)
    middle = np.array(mask.shape[::-1]) / 2
    gap = np.linalg.norm((centres[1:] - middle) / middle, axis=1)
    merit = stats[1:, cv2.CC_STAT_AREA] * np.exp(-2 * gap * gap)
    keep = np.flatnonzero(merit > 0.2 * merit.max()) + 1
    return np.isin(labels, keep)


def _check(mask: Bools, strange: Floats, rgb: Bytes, name: str) -> None:
    """Raise CaptureError CAPTURE_NO_OBJECT for a mask that is tiny, without contrast or cut off on every side."""
    share = float(mask.mean())
    if share < _AREA[0]:
        raise _no_object(name, "shows nothing that stands out from its background")
    if float(np.median(strange[mask])) < _PERHAPS or _outline_contrast(rgb, mask) < _OUTLINE:
        raise _no_object(name, "shows nothing whose colours differ from those of its background")
    sides = mask[0].mean(), mask[-1].mean(), mask[:, 0].mean(), mask[:, -1].mean()
    if share > _AREA[1] or all(side > _EDGE for side in sides):
        raise _no_object(name, "shows something that reaches beyond the picture on every side")


def _outline_contrast(rgb: Bytes, mask: Bools) -> float:
    """Median change of colour across the mask's outline, in CIELAB per pixel."""
    lab = _lab(rgb)
    across, down = (cv2.Sobel(lab, cv2.CV_32F, *axis, scale=1 / 8) for axis in ((1, 0), (0, 1)))
    steep = np.sqrt((across * across + down * down).sum(axis=2))
    kernel = np.ones((3, 3), np.uint8)
    outline = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_GRADIENT, kernel).astype(bool) & _inside(mask.shape)
    return float(np.median(steep[outline])) if outline.any() else 0.0


def _no_object(name: str, reason: str) -> CaptureError:
    return CaptureError("CAPTURE_NO_OBJECT", reason, file=name, hints=_ADVICE)
