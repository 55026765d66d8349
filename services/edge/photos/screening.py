"""Photos that would only do harm: dark ones, copies, and blurred ones where enough others are sharp.

Everything is judged on small pictures, because what cannot be seen there cannot be matched either.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from services.edge.arrays import Bools, Floats, Tick
from services.edge.capture.nouns import Photo, PhotoVerdict
from services.edge.errors import CaptureError

LONGEST = 480  # pixels of the pictures that are judged
# Black in the middle of its tones and hardly lighter anywhere: 8-bit luma, 50th and 95th percentile. Both, since a
# thing photographed on black velvet is dark in the middle too.
_DARK = (16.0, 40.0)
# Sharpness, of the capture's median. Photos in focus have 0.59 and more, those smeared over 8 pixels of 480 have 0.17
# to 0.37, and 5 pixels 0.20 to 0.56, of which the matching still makes something.
_BLURRED = 0.4
_COARSE_PX = 4.0  # 1 sigma: smears that matter are no wider than what is left after it
_NOTHING = 0.1  # (grey steps per pixel)² left at _COARSE_PX; photos have 1 and more, walls and skies 0.01
_KEPT_SHARE = 0.7  # of the photos: a blurred one still closes a gap, and gaps break the alignment
_STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))  # (rows, columns): a smear takes fine detail away in one direction only
_THUMB = (72, 54)  # pixels; small enough for the damage of another JPEG to average out
_COPY_BITS = 8  # of the 64 in the hash that may differ: a JPEG of quality 40 at half the size turns up to 6
# Mean difference of luma over its standard deviation: such copies have 0.02 to 0.06, photos from 2 degrees apart 0.25
# and more. A camera that was only turned by half a degree has 0.02 to 0.08, and shows nothing new either.
_COPY_CHANGE = 0.08


@dataclass(frozen=True, slots=True)
class _Look:
    """What is kept of a photo: sharpness (4,) by direction, NaN where there is nothing to be sharp; hash (64,) bool;
    thumb (h,w) float32 luma; tones: two percentiles of luma."""

    photo: Photo
    sharpness: Floats
    hash: Bools
    thumb: Floats
    tones: tuple[float, float]


def screen(photos: Sequence[Photo], *, tick: Tick) -> tuple[tuple[Photo, ...], tuple[PhotoVerdict, ...]]:
    """The photos worth aligning, in their order, and a verdict on each of the others."""
    verdicts: list[PhotoVerdict] = []
    looks: list[_Look] = []
    for number, photo in enumerate(photos):
        tick(number / len(photos))
        try:
            look = _look(photo)
        except CaptureError as error:
            advice = f"It {error.message}; send it again as a JPEG or HEIC."
            verdicts.append(PhotoVerdict(photo.name, "unreadable", advice))
            continue
        refused = _dark(look) or _copy(look, looks)
        if refused is None:
            looks.append(look)
        else:
            verdicts.append(refused)
    blurred = _blurred(looks)
    kept = tuple(look.photo for look in looks if look.photo.name not in blurred)
    return kept, (*verdicts, *(_blur_verdict(name) for name in blurred))


def _look(photo: Photo) -> _Look:
    luma = cv2.cvtColor(photo.load(LONGEST), cv2.COLOR_RGB2GRAY).astype(np.float32)
    tones = np.percentile(luma, (50, 95))
    thumb = np.asarray(cv2.resize(luma, _THUMB, interpolation=cv2.INTER_AREA), np.float32)
    return _Look(photo, _sharpness(luma), _difference_hash(luma), thumb, (float(tones[0]), float(tones[1])))


def _sharpness(luma: Floats) -> Floats:
    """(4,) energy of the differences between neighbours, over what of it a wide blur leaves.

    Contrast falls out, so a soft thing before a smooth wall is not taken for a smear; noise counts as detail, which
    errs on the side of keeping.
    """
    coarse = np.asarray(cv2.GaussianBlur(luma, (0, 0), _COARSE_PX), np.float32)
    fine, left = _change(luma), _change(coarse)
    return np.where(left.min() > _NOTHING, fine / np.maximum(left, _NOTHING), np.nan)


def _change(luma: Floats) -> Floats:
    """(4,) mean squared difference between a pixel and the one a step further."""
    height, width = luma.shape
    inner = luma[1:-1, 1:-1]
    ahead = (luma[1 + y : height - 1 + y, 1 + x : width - 1 + x] for y, x in _STEPS)
    return np.array([np.square(there - inner).mean() if inner.size else 0.0 for there in ahead])


def _difference_hash(luma: Floats) -> Bools:
    """(64,) bool: whether it grows lighter from cell to cell, on 8 rows of 9."""
    cells = cv2.resize(luma, (9, 8), interpolation=cv2.INTER_AREA)
    lighter: Bools = cells[:, 1:] > cells[:, :-1]
    return lighter.reshape(-1)


def _dark(look: _Look) -> PhotoVerdict | None:
    if all(tone < limit for tone, limit in zip(look.tones, _DARK, strict=True)):
        return PhotoVerdict(look.photo.name, "dark", "It is almost black; take it again with more light.")
    return None


def _copy(look: _Look, kept: Sequence[_Look]) -> PhotoVerdict | None:
    """Against all that were kept, the last first: a copy mostly comes right behind its original."""
    for other in reversed(kept):
        alike = int((look.hash != other.hash).sum()) <= _COPY_BITS
        if alike and np.abs(look.thumb - other.thumb).mean() <= _COPY_CHANGE * other.thumb.std():
            advice = f"It shows the same as {other.photo.name}; take a step to the side between photos."
            return PhotoVerdict(look.photo.name, "duplicate", advice)
    return None


def _blurred(looks: Sequence[_Look]) -> list[str]:
    """Names of the photos to leave out, the worst first, as many as may go."""
    if not looks:
        return []
    sharpness = np.stack([look.sharpness for look in looks])
    judged = ~np.isnan(sharpness[:, 0])
    if not judged.any():
        return []
    share = np.where(judged, (sharpness / np.median(sharpness[judged], axis=0)).min(axis=1), np.inf)
    may_go = int((1 - _KEPT_SHARE) * len(looks))
    worst = np.argsort(share, kind="stable")[:may_go]
    return [looks[at].photo.name for at in worst if share[at] < _BLURRED]


def _blur_verdict(name: str) -> PhotoVerdict:
    return PhotoVerdict(name, "blur", "It is blurred; hold still while taking it, or use more light.")
