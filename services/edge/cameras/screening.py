"""Screen out photos that would harm the alignment: dark ones, duplicates, and blurred ones if enough others are sharp.

All are judged on downscaled pictures: details that are not visible there cannot be matched either.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath

import cv2
import numpy as np

from capture2vr.edge.arrays import Bools, Floats, Tick
from capture2vr.edge.cameras.features import resize_mask
from capture2vr.edge.capture.nouns import Photo, PhotoVerdict
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.parallel import in_threads
from capture2vr.sentences.sentence import say

LONGEST_PX = 480  # longer side of the downscaled pictures
# A photo is dark if its 50th and 95th percentile of 8-bit luma are below these. Both, since an object photographed on
# black velvet has a dark median too.
_DARK = (16.0, 40.0)
# Least sharpness, over the capture's median. Photos in focus have 0.59 and more, those smeared over 8 pixels of 480
# have 0.17 to 0.37, and over 5 pixels 0.20 to 0.56, which can still be matched.
_BLURRED = 0.4
_COARSE_PX = 4.0  # 1 sigma of the wide blur: smears that matter are no wider than the detail that it leaves
_NOTHING = 0.1  # (grey steps per pixel)² left after _COARSE_PX; photos have 1 and more, walls and skies 0.01
_KEPT_SHARE = 0.7  # of the photos are never dropped as blurred: they may close a gap, and gaps break the alignment
_STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))  # (rows, columns): motion blur removes fine detail in one direction only
_THUMB = (72, 54)  # pixels, width and height; small enough to average out JPEG artefacts
_COPY_BITS = 8  # of the hash's 64 bits may differ: a JPEG of quality 40 at half the size changes up to 6
# Mean difference of luma over its standard deviation: such copies have 0.02 to 0.06, photos from 2 degrees apart 0.25
# and more. A camera that only turned by half a degree has 0.02 to 0.08, and shows nothing new either.
_COPY_CHANGE = 0.08


@dataclass(frozen=True, slots=True)
class _PhotoTraits:
    """Measurements of a photo for screening.

    sharpness (4,) by direction, NaN for a picture without detail; hash (64,) bool: perceptual hash;
    thumb (h,w) float32 luma; tones: 50th and 95th percentile of luma inside the photo's mask.
    """

    photo: Photo
    sharpness: Floats
    hash: Bools
    thumb: Floats
    tones: tuple[float, float]


def screen(photos: Sequence[Photo], *, tick: Tick) -> tuple[tuple[Photo, ...], tuple[PhotoVerdict, ...]]:
    """Return the photos worth aligning, in their order, and a verdict on each of the others."""
    verdicts: list[PhotoVerdict] = []
    accepted: list[_PhotoTraits] = []
    copies: list[tuple[str, int]] = []
    for photo, traits in zip(photos, in_threads(_traits_or_error, photos, tick), strict=True):
        if isinstance(traits, CaptureError):
            advice = say("send_again_as_jpeg_heic_what", what=traits.message)
            verdicts.append(PhotoVerdict(photo.name, "unreadable", advice))
            continue
        verdict = _dark_verdict(traits)
        if verdict is not None:
            verdicts.append(verdict)
        elif (at := _place_of_same(traits, accepted)) is None:
            accepted.append(traits)
        else:
            accepted[at], copy = _original_first(accepted[at], traits)
            copies.append((copy.photo.name, at))
    same = [_duplicate_verdict(name, accepted[at].photo.name) for name, at in copies]
    blurred = _blurred_names(accepted)
    photos_left = tuple(traits.photo for traits in accepted if traits.photo.name not in blurred)
    return photos_left, (*verdicts, *same, *(_blur_verdict(name) for name in blurred))


def _traits_or_error(photo: Photo) -> _PhotoTraits | CaptureError:
    """Load a photo and measure it; or return why it cannot be read."""
    try:
        return _photo_traits(photo)
    except CaptureError as error:
        return error


def _photo_traits(photo: Photo) -> _PhotoTraits:
    """Load a photo and measure it. Raises CaptureError."""
    luma = cv2.cvtColor(photo.load(LONGEST_PX), cv2.COLOR_RGB2GRAY).astype(np.float32)
    shown = luma if photo.mask is None else luma[resize_mask(photo.mask, luma.shape)]
    tones = np.percentile(shown if shown.size else luma, (50, 95))
    thumb = np.asarray(cv2.resize(luma, _THUMB, interpolation=cv2.INTER_AREA), np.float32)
    return _PhotoTraits(photo, _sharpness(luma), _difference_hash(luma), thumb, (float(tones[0]), float(tones[1])))


def _sharpness(luma: Floats) -> Floats:
    """Return the sharpness (4,) by direction: mean squared difference of neighbours, over the same after a wide blur.

    The ratio is independent of contrast, so a soft object in front of a smooth wall does not count as blurred. Noise
    counts as detail, so in doubt a photo is kept.
    """
    coarse = np.asarray(cv2.GaussianBlur(luma, (0, 0), _COARSE_PX), np.float32)
    fine, left = _change(luma), _change(coarse)
    return np.where(left.min() > _NOTHING, fine / np.maximum(left, _NOTHING), np.nan)


def _change(luma: Floats) -> Floats:
    """Return the mean squared difference (4,) between a pixel and its neighbour, for each step of _STEPS."""
    height, width = luma.shape
    inner = luma[1:-1, 1:-1]
    ahead = (luma[1 + y : height - 1 + y, 1 + x : width - 1 + x] for y, x in _STEPS)
    return np.array([np.square(there - inner).mean() if inner.size else 0.0 for there in ahead])


def _difference_hash(luma: Floats) -> Bools:
    """Compute a perceptual hash (64,) bool, dHash: whether each of 8 rows of 9 cells gets lighter from cell to cell."""
    cells = cv2.resize(luma, (9, 8), interpolation=cv2.INTER_AREA)
    lighter: Bools = cells[:, 1:] > cells[:, :-1]
    return lighter.reshape(-1)


def _dark_verdict(traits: _PhotoTraits) -> PhotoVerdict | None:
    """Return a verdict if the photo is almost black."""
    if all(tone < limit for tone, limit in zip(traits.tones, _DARK, strict=True)):
        return PhotoVerdict(traits.photo.name, "dark", say("almost_black_take_again"))
    return None


def _place_of_same(traits: _PhotoTraits, accepted: Sequence[_PhotoTraits]) -> int | None:
    """Find the accepted photo that one is a copy of; the last is compared first, as it is most likely."""
    for at, other in reversed([*enumerate(accepted)]):
        alike = int((traits.hash != other.hash).sum()) <= _COPY_BITS
        if alike and np.abs(traits.thumb - other.thumb).mean() <= _COPY_CHANGE * other.thumb.std():
            return at
    return None


def _original_first(first: _PhotoTraits, second: _PhotoTraits) -> tuple[_PhotoTraits, _PhotoTraits]:
    """Order two of the same picture: "a.jpg" before "a (1).jpg" or "a - Copy.jpg", which sort first."""
    stem, other = PurePosixPath(first.photo.name).stem, PurePosixPath(second.photo.name).stem
    return (second, first) if stem != other and stem.startswith(other) else (first, second)


def _duplicate_verdict(name: str, original: str) -> PhotoVerdict:
    return PhotoVerdict(name, "duplicate", say("shows_same_as_take_step", name=original))


def _blurred_names(accepted: Sequence[_PhotoTraits]) -> list[str]:
    """Return the names of the blurred photos to drop, the worst first, at most as many as _KEPT_SHARE allows."""
    if not accepted:
        return []
    sharpness = np.stack([traits.sharpness for traits in accepted])
    judged = ~np.isnan(sharpness[:, 0])
    if not judged.any():
        return []
    share = np.where(judged, (sharpness / np.median(sharpness[judged], axis=0)).min(axis=1), np.inf)
    most = int((1 - _KEPT_SHARE) * len(accepted))
    worst = np.argsort(share, kind="stable")[:most]
    return [accepted[at].photo.name for at in worst if share[at] < _BLURRED]


def _blur_verdict(name: str) -> PhotoVerdict:
    return PhotoVerdict(name, "blur", say("blurred_hold_still_while_taking"))
