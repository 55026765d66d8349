"""Detect photos of an object turning in front of a still camera (a turntable), and mask the still background.

With the background, structure from motion would find that no camera moves. Without it, it finds cameras that move
around the object.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import cv2
import numpy as np

from capture2vr.edge.arrays import Bools, Floats, Tick, no_tick
from capture2vr.edge.capture.nouns import Frame, Photo
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.parallel import in_threads
from capture2vr.edge.photos.crop import CropRectangle, crop_photo

_LONGEST = 320  # longer side in pixels of the compared pictures: shake of two pixels of a photo disappears in them
_ONE_CAMERA = 0.8  # least share of the photos that the still camera took; the others were edited, or do not belong here
_LEAST_PX = 8  # shorter side of the compared pictures; in narrower ones nothing can be told from the border
_SMOOTH_PX = 1.2  # 1 sigma of the blur against noise
_WINDOW_PX = 5  # side of the windows that are compared
_NOISE = 2.0  # grey levels that noise, JPEG and flickering lamps leave after smoothing
_SHAKE_PX = 0.5  # camera shake, in pixels of the compared pictures
_UNLIKE = 2.0  # largest difference over what noise and shake explain; another texture differs four times as much
_ASKED = 8  # photos on which the decision is made: 30 ms and the time to decode them
_COMPARED = 24  # photos from which the background is computed
_BORDER = 0.08  # width of the border, of the longer side
_STILL_BORDER = 0.7  # least still share of the border: turntables have 1, walks 0.4, all of it without texture
_STILL, _MOVES = 0.7, 0.5  # share of the pairs that are the same: above still, below moving; between, at times occluded
_TEXTURE = 3.0  # least gradient, grey levels per pixel; less gives no key points, so it does no harm
_TEXTURED = 0.03  # least share of the picture that is still and textured: turntables have 0.5, walks 0.002
_QUADRANT = 0.02  # the same in at least two quarters of the picture, since a date or a thumb is in one corner only
_MOVING = 0.004  # least share of the picture that moves: less is too small to be matched
_SEEN_ALIKE = 0.12  # least share of other photos with the same background pixel; few agree on the object's texture
_PART = 0.05  # least area of a region, over the largest one: smaller ones are leaves and shadows
_MARGIN = 0.03  # of a side, around the moving region
_NARROWEST = 0.5  # least size of the crop, of a side
_FROM_ABOVE = 0.2  # weight of the optical axis in the up direction: it decides for cameras 80 degrees downward and more
_LEAST_TURN = 0.02  # radians from photo to photo; less is no turntable


@dataclass(frozen=True, slots=True)
class _SmallPhoto:
    """A downscaled, smoothed photo. grey (H,W) float32; slope (H,W): mean square of its gradient in windows."""

    grey: Floats
    slope: Floats

    @classmethod
    def of(cls, photo: Photo) -> _SmallPhoto:
        grey = cv2.cvtColor(photo.load(_LONGEST), cv2.COLOR_RGB2GRAY).astype(np.float32)
        grey = np.asarray(cv2.GaussianBlur(grey, (0, 0), _SMOOTH_PX))
        down, across = np.gradient(grey)
        return cls(grey, _mean(np.square(down) + np.square(across)))


def mask_background(photos: Sequence[Photo], tick: Tick = no_tick) -> tuple[Photo, ...]:
    """Mask the still background of turntable photos, and crop them to the object; () if it is not a turntable.

    Photos that cannot be read get no mask: screening reports them later. Nor do the few that another camera took, or
    that were edited: what they show of the background matches nothing in the others.
    """

    def watch(_: float) -> None:
        tick(0.0)  # most captures end before the masks: their bar must not jump back

    taken = _of_one_camera(photos)
    if not taken or _is_narrow(taken[0]) or not _has_still_background(_small_photos(taken, _ASKED, watch)):
        return ()
    background = _Background.of(_small_photos(taken, _COMPARED, watch))
    names = {photo.name for photo in taken}
    masked = []
    for number, photo in enumerate(photos):
        masked.append(_mask_photo(photo, background) if photo.name in names else photo)
        tick((number + 1) / len(photos))
    thing = thing_box(masked)
    # Centred at the optical axis, and not so narrow that a normal lens would picture like a telephoto lens.
    side = max(1 - 2 * min(thing.left, 1 - thing.right), 1 - 2 * min(thing.top, 1 - thing.bottom), _NARROWEST)
    margin = (1 - side) / 2
    return tuple(crop_photo(photo, CropRectangle(margin, margin, 1 - margin, 1 - margin)) for photo in masked)


def thing_box(photos: Sequence[Photo]) -> CropRectangle:
    """Compute the bounding box of the foreground masks of all photos, with a margin, to crop the photos."""
    seen = np.any([photo.mask for photo in photos if photo.mask is not None], axis=0)
    (top, bottom), (left, right) = (_span(seen.any(axis=axis)) for axis in (1, 0))
    return CropRectangle(left, top, right, bottom)


def _span(seen: Bools) -> tuple[float, float]:
    """Return the first and the last True as shares of the length, with a margin; (0, 1) if there is none."""
    found = np.flatnonzero(seen)
    if not len(found):
        return 0.0, 1.0
    return max(0.0, found[0] / len(seen) - _MARGIN), min(1.0, (found[-1] + 1) / len(seen) + _MARGIN)


def axis_up(frames: Sequence[Frame]) -> Floats | None:
    """Return the unit vector (3,) along the turntable's axis, pointing up as the pictures do; None if it hardly turns.

    From one frame to the next the camera rotates about this axis only, wherever it looks.
    """
    poses = np.stack([np.asarray(frame.camera_to_world, np.float64)[:3, :3] for frame in frames])
    steps = np.einsum("nij,nkj->nik", poses[1:], poses[:-1])
    # The skew part of a rotation is its axis times the sine of its angle.
    turns = np.stack(
        [steps[:, 2, 1] - steps[:, 1, 2], steps[:, 0, 2] - steps[:, 2, 0], steps[:, 1, 0] - steps[:, 0, 1]]
    )
    values, vectors = np.linalg.eigh(turns @ turns.T / max(1, len(steps)))
    if values[2] < (2 * _LEAST_TURN) ** 2:
        return None
    axis: Floats = vectors[:, 2]
    # Up is the pictures' up; for pictures from right above, which have none, it is the side that the camera is on.
    upright = float(axis @ -(poses[:, :, 1] + _FROM_ABOVE * poses[:, :, 2]).mean(axis=0))
    return axis if upright >= 0 else -axis


def _of_one_camera(photos: Sequence[Photo]) -> tuple[Photo, ...]:
    """Return the photos that one still camera can have taken: same camera, size and orientation.

    () where these are fewer than _ONE_CAMERA of all, or where photos have poses."""
    if any(photo.camera_to_world is not None for photo in photos):
        return ()
    (usual, count), *_ = Counter(map(_camera_of, photos)).most_common(1)
    if count < _ONE_CAMERA * len(photos):
        return ()
    return tuple(photo for photo in photos if _camera_of(photo) == usual)


def _camera_of(photo: Photo) -> tuple[str, tuple[int, int], int]:
    return photo.camera, photo.size, photo.turns


def _is_narrow(photo: Photo) -> bool:
    """Return whether a photo is a line or a few pixels: it then shows no thing, and has no gradient."""
    return min(photo.size) * min(1.0, _LONGEST / max(photo.size)) < _LEAST_PX


def _small_photos(photos: Sequence[Photo], most: int, tick: Tick) -> list[_SmallPhoto]:
    """Load at most `most` evenly spaced photos, downscaled, without the unreadable ones."""
    chosen = np.linspace(0, len(photos) - 1, min(most, len(photos))).round().astype(int)

    def load(number: int) -> _SmallPhoto | None:
        try:
            return _SmallPhoto.of(photos[number])
        except CaptureError:
            return None

    return [picture for picture in in_threads(load, chosen.tolist(), tick) if picture is not None]


def _has_still_background(pictures: Sequence[_SmallPhoto]) -> bool:
    """Return whether the border and enough textured regions stand still while something moves."""
    if len(pictures) < 3:
        return False
    alike = np.mean([_same_mask(one, other) for one, other in combinations(pictures, 2)], axis=0)
    still, textured = alike >= _STILL, np.mean([picture.slope for picture in pictures], axis=0) > _TEXTURE**2
    height, width = alike.shape
    still_texture = still & textured
    quarters = (still_texture[rows, columns] for rows in _halves(height) for columns in _halves(width))
    return bool(
        still[_border(alike.shape)].mean() >= _STILL_BORDER
        and still_texture.mean() >= _TEXTURED
        and sum(quarter.mean() >= _QUADRANT for quarter in quarters) >= 2
        and ((alike < _MOVES) & textured).mean() >= _MOVING
    )


def _halves(length: int) -> tuple[slice, slice]:
    return slice(0, length // 2), slice(length // 2, length)


def _same_mask(one: _SmallPhoto, other: _SmallPhoto) -> Bools:
    """Return a mask (H,W): True where two pictures are the same except for noise, slight shake and exposure."""
    border = _border(one.grey.shape)
    gain = float(np.median((one.grey[border] + 1) / (other.grey[border] + 1)))
    allowed = _NOISE**2 + _SHAKE_PX**2 * (one.slope + other.slope) / 2
    return _mean((one.grey - gain * other.grey) ** 2) < _UNLIKE**2 * allowed


def _border(shape: tuple[int, ...]) -> Bools:
    """Return a mask of shape (H,W): True along the picture's border."""
    band = max(1, round(_BORDER * max(shape)))
    border = np.ones(shape, bool)
    border[band:-band, band:-band] = False
    return border


def _mean(values: Floats) -> Floats:
    """Return the means over windows."""
    return np.asarray(cv2.blur(values, (_WINDOW_PX, _WINDOW_PX)))


@dataclass(frozen=True, slots=True)
class _Background:
    """The still background, without the object; known (H,W): True where some photos show it."""

    picture: _SmallPhoto
    known: Bools

    @classmethod
    def of(cls, pictures: Sequence[_SmallPhoto]) -> _Background:
        """Estimate the still background: take each pixel from the photo that agrees with most others."""
        votes = np.zeros((len(pictures), *pictures[0].grey.shape), np.int16)
        for one, other in combinations(range(len(pictures)), 2):
            alike = _same_mask(pictures[one], pictures[other])
            votes[one] += alike
            votes[other] += alike
        border = _border(pictures[0].grey.shape)
        level = float(np.median(pictures[0].grey[border]))
        evened = np.stack(
            [picture.grey * (level / max(float(np.median(picture.grey[border])), 1.0)) for picture in pictures]
        )
        best = votes.argmax(axis=0)[None]
        grey, slope = (
            np.take_along_axis(every, best, axis=0)[0]
            for every in (evened, np.stack([picture.slope for picture in pictures]))
        )
        return cls(_SmallPhoto(grey, slope), votes.max(axis=0) >= _SEEN_ALIKE * len(pictures))


def _mask_photo(photo: Photo, background: _Background) -> Photo:
    """Return the photo with a mask of what differs from the background; without one if it cannot be read."""
    try:
        picture = _SmallPhoto.of(photo)
    except CaptureError:
        return photo
    return replace(photo, mask=_clean_mask(~(_same_mask(picture, background.picture) & background.known)))


def _clean_mask(moving: Bools) -> Bools:
    """Remove specks and fill holes of a mask (H,W). It needs no widening: the windows did that."""
    mask = cv2.morphologyEx(moving.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    areas = [cv2.contourArea(outline) for outline in outlines]
    large = [outline for outline, area in zip(outlines, areas, strict=True) if area >= _PART * max(areas)]
    filled = np.zeros(moving.shape, np.uint8)
    cv2.drawContours(filled, large, -1, 1, cv2.FILLED)
    return filled.astype(bool)
