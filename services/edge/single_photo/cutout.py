"""The thing in a photo: which pixels are it, and the square around it that the network sees. numpy and OpenCV.

An alpha channel says it; otherwise GrabCut does (Rother et al. 2004), started from what differs from the colours along
the picture's border and lies near its middle.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from services.edge.arrays import Bools, Bytes, Floats
from services.edge.capture.nouns import Photo
from services.edge.errors import CaptureError

LONGEST = 320
"""Pixels of the picture that is cut: GrabCut takes 0.2 s, and the network sees 64."""
_BORDER = 0.04  # of the longer side: what is so near the edge is background, or the thing is not in the picture
_BORDER_COLOURS = 4
_ROUNDS = 5  # of GrabCut
_SURELY, _PERHAPS = 2.5, 1.2  # times the usual distance of border colours from their centres
_LEAST_LAB = 7.0  # distance in CIELAB that lamps and lenses make of one wall
_LIGHTNESS = 0.6  # of it that counts: shadows are darker than their ground and of the same colour
_OUTLINE = 1.2  # CIELAB per pixel across the outline; things have 4 and more, what a lens dims has no outline
_AREA = (0.005, 0.92)  # shares of the picture that a thing takes
_EDGE = 0.25  # of a side of the picture: more than so much of it covered, and the thing touches that side
_OPAQUE = 128
_ADVICE = (
    "take the photo so that the whole thing is in it, with some background on every side",
    "choose a background of another colour than the thing, in even light",
)


@dataclass(frozen=True, slots=True)
class CutOut:
    """rgb (h,w,3) uint8 upright, and mask (h,w) of the thing."""

    rgb: Bytes
    mask: Bools


def cut_out(photo: Photo) -> CutOut:
    """An alpha channel tells the thing where it hides anything at all.

    Raises CaptureError CAPTURE_NO_OBJECT where nothing stands out, or what does is cut off on every side.
    """
    stored = photo.load(LONGEST)
    alpha = photo.load_alpha() if photo.load_alpha else None
    rgb = upright(stored, photo.turns)
    if alpha is None or not 0 < (alpha >= _OPAQUE).mean() < 1:
        return CutOut(rgb, standing_out(rgb, photo.name))
    height, width = stored.shape[:2]
    small = np.asarray(cv2.resize(alpha, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    return CutOut(rgb, upright(small, photo.turns) >= _OPAQUE)


def upright(pixels: Bytes, turns: int) -> Bytes:
    """Quarter turns clockwise."""
    return np.ascontiguousarray(np.rot90(pixels, -turns))


def standing_out(rgb: Bytes, name: str) -> Bools:
    """(h,w): what differs from the border. Raises CaptureError CAPTURE_NO_OBJECT."""
    strange = _strangeness(rgb)
    seeds = _seeds(strange)
    if seeds is None:
        raise _no_object(name, "shows nothing that stands out from its background")
    cv2.setRNGSeed(0)  # GrabCut draws its first colour clusters
    models = np.zeros((1, 65)), np.zeros((1, 65))
    whole = (0, 0, 0, 0)  # not looked at: the seeds say where to begin
    labels, _, _ = cv2.grabCut(rgb[..., ::-1].copy(), seeds, whole, *models, _ROUNDS, cv2.GC_INIT_WITH_MASK)
    mask = _main_part((labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD))
    _check(mask, strange, rgb, name)
    return mask


def square(cut: CutOut, side: int, fill: float, *, shift: tuple[float, float] = (0.0, 0.0)) -> Floats:
    """(side,side,4) float32 in [0,1], colours times mask and mask; the thing's longer side takes `fill` of it, its
    middle lies `shift` squares right of and below the square's."""
    rows, columns = np.flatnonzero(cut.mask.any(axis=1)), np.flatnonzero(cut.mask.any(axis=0))
    top, bottom, left, right = rows[0], rows[-1] + 1, columns[0], columns[-1] + 1
    length = max(bottom - top, right - left) / fill
    x0 = (left + right) / 2 - length * (0.5 + shift[0])
    y0 = (top + bottom) / 2 - length * (0.5 + shift[1])
    # Drawn finer than the photo where that is finer, then averaged. Pixel i lies at x0 + (i + ½)·by − ½ of the photo.
    fine = side * max(1, int(np.ceil(length / side)))
    by = length / fine
    warp = np.array([[by, 0, x0 + by / 2 - 0.5], [0, by, y0 + by / 2 - 0.5]])
    mask = cut.mask[..., None].astype(np.float32)
    layers = np.concatenate([cut.rgb / np.float32(255) * mask, mask], axis=2)
    drawn = cv2.warpAffine(layers, warp, (fine, fine), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    return np.asarray(cv2.resize(drawn, (side, side), interpolation=cv2.INTER_AREA), np.float32)


def _strangeness(rgb: Bytes) -> Floats:
    """(h,w): how far a pixel's colour is from those along the border, in their usual distances from one another."""
    lab = _lab(rgb)
    border = lab[~_inside(lab.shape[:2])]
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 20, 0.5)
    cv2.setRNGSeed(0)
    unlabelled = np.zeros((len(border), 1), np.int32)
    compactness, _, centres = cv2.kmeans(border, _BORDER_COLOURS, unlabelled, criteria, 3, cv2.KMEANS_PP_CENTERS)
    usual = max(_LEAST_LAB, 2 * float(np.sqrt(compactness / len(border))))
    away = np.min([np.sqrt(((lab - centre) ** 2).sum(axis=2)) for centre in centres], axis=0)
    return np.asarray(away / usual)


def _lab(rgb: Bytes) -> Floats:
    """(h,w,3) CIELAB without noise and with less lightness."""
    lab = cv2.cvtColor(cv2.GaussianBlur(rgb, (0, 0), 1.5).astype(np.float32) / 255, cv2.COLOR_RGB2LAB)
    return np.asarray(lab * np.array([_LIGHTNESS, 1, 1], np.float32))


def _inside(shape: tuple[int, ...]) -> Bools:
    """(h,w) False along the border."""
    band = max(2, round(_BORDER * max(shape)))
    inside = np.zeros(shape, bool)
    inside[band:-band, band:-band] = True
    return inside


def _seeds(strange: Floats) -> Bytes | None:
    """GrabCut's first labels, or None where nothing is strange. The middle needs to be less so than the edge."""
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
    """The component that is large and near the middle, with those that belong to it, without holes of a few pixels."""
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
    share = float(mask.mean())
    if share < _AREA[0]:
        raise _no_object(name, "shows nothing that stands out from its background")
    if float(np.median(strange[mask])) < _PERHAPS or _outline(rgb, mask) < _OUTLINE:
        raise _no_object(name, "shows nothing whose colours differ from those of its background")
    sides = mask[0].mean(), mask[-1].mean(), mask[:, 0].mean(), mask[:, -1].mean()
    if share > _AREA[1] or all(side > _EDGE for side in sides):
        raise _no_object(name, "shows something that reaches beyond the picture on every side")


def _outline(rgb: Bytes, mask: Bools) -> float:
    """How fast colours change across the mask's outline, in the middle."""
    lab = _lab(rgb)
    across, down = (cv2.Sobel(lab, cv2.CV_32F, *axis, scale=1 / 8) for axis in ((1, 0), (0, 1)))
    steep = np.sqrt((across * across + down * down).sum(axis=2))
    kernel = np.ones((3, 3), np.uint8)
    outline = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_GRADIENT, kernel).astype(bool) & _inside(mask.shape)
    return float(np.median(steep[outline])) if outline.any() else 0.0


def _no_object(name: str, reason: str) -> CaptureError:
    return CaptureError("CAPTURE_NO_OBJECT", reason, file=name, hints=_ADVICE)
