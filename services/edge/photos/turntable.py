"""Photos of a thing that turns before a still camera: told by what stands still, which is left out before the matching.

Structure from motion takes the still background for the world, in which then nothing moves. Without it the thing is
the world, and the camera goes round it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import cv2
import numpy as np

from services.edge.arrays import Bools, Floats, Tick, no_tick
from services.edge.capture.nouns import Frame, Photo
from services.edge.errors import CaptureError
from services.edge.photos.crop import Box, cropped

_LONGEST = 320  # pixels of the pictures that are compared: in them two pixels of a photo are no shake
_SMOOTH_PX = 1.2  # 1 sigma, against noise
_WINDOW_PX = 5
_NOISE = 2.0  # grey levels that smoothing leaves of noise, JPEG and lamps
_SHAKE_PX = 0.5
_UNLIKE = 2.0  # times what noise and shake explain; another texture differs four times as much
_ASKED = 8  # photos that decide: 30 ms and what it takes to decode them
_COMPARED = 24  # photos that tell the background
_BORDER = 0.08  # of the longer side
_STILL_BORDER = 0.7  # share of the border: turntables have 1, walks 0.4 of which nothing has texture
_STILL, _MOVES = 0.7, 0.5  # share of the pairs that are alike; between them lies what the thing hides at times
_TEXTURE = 3.0  # grey levels a pixel: what has less gives no key points, and does no harm
_TEXTURED = 0.03  # share of the picture that is still and has texture: turntables have 0.5, walks 0.002
_QUADRANT = 0.02  # the same of a quarter of the picture; of at least two, since a date or a thumb is in one corner
_MOVING = 0.004  # share of the picture that moves: less is too small to be matched
_SEEN_ALIKE = 0.12  # share of other photos that agree on a pixel of the background; of a thing's texture few do
_PART = 0.05  # of the thing: pieces below it are leaves and shadows
_MARGIN = 0.03  # of a side, around what moves
_NARROWEST = 0.5  # of a side
_FROM_ABOVE = 0.2  # of the optical axis: what tells of 80 degrees downward and more
_LEAST_TURN = 0.02  # radians from photo to photo


@dataclass(frozen=True, slots=True)
class _Look:
    """A photo made small. grey (H,W) float32; slope (H,W): mean square of its gradient in windows."""

    grey: Floats
    slope: Floats

    @classmethod
    def of(cls, photo: Photo) -> _Look:
        grey = cv2.cvtColor(photo.load(_LONGEST), cv2.COLOR_RGB2GRAY).astype(np.float32)
        grey = np.asarray(cv2.GaussianBlur(grey, (0, 0), _SMOOTH_PX))
        down, across = np.gradient(grey)
        return cls(grey, _mean(np.square(down) + np.square(across)))


def without_background(photos: Sequence[Photo], tick: Tick = no_tick) -> tuple[Photo, ...]:
    """The photos with masks of what moves where all else stands still; none where that is not so.

    Photos that cannot be read get no mask: what comes next tells of them.
    """
    if not _one_camera(photos) or not _still_behind(_looks(photos, _ASKED)):
        return ()
    background = _Background.of(_looks(photos, _COMPARED))
    masked = []
    for number, photo in enumerate(photos):
        masked.append(_masked(photo, background))
        tick((number + 1) / len(photos))
    thing = thing_box(masked)
    # About the middle, where the lens's axis is; and not so narrow that a usual lens would become a long one.
    side = max(1 - 2 * min(thing.left, 1 - thing.right), 1 - 2 * min(thing.top, 1 - thing.bottom), _NARROWEST)
    margin = (1 - side) / 2
    return tuple(cropped(photo, Box(margin, margin, 1 - margin, 1 - margin)) for photo in masked)


def thing_box(photos: Sequence[Photo]) -> Box:
    """The part of the photos in which anything moves, and a margin."""
    seen = np.any([photo.mask for photo in photos if photo.mask is not None], axis=0)
    (top, bottom), (left, right) = (_span(seen.any(axis=axis)) for axis in (1, 0))
    return Box(left, top, right, bottom)


def _span(seen: Bools) -> tuple[float, float]:
    """First and last True, as shares of the length, with a margin; all of it where there is none."""
    found = np.flatnonzero(seen)
    if not len(found):
        return 0.0, 1.0
    return max(0.0, found[0] / len(seen) - _MARGIN), min(1.0, (found[-1] + 1) / len(seen) + _MARGIN)


def axis_up(frames: Sequence[Frame]) -> Floats | None:
    """(3,) unit vector along the axis that the cameras went round, against gravity: the way the pictures stand.

    From one frame to the next the camera turns about that axis and nothing else, whatever it looks at. None where it
    hardly turns.
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
    # The pictures' own up; where they were taken from right above there is none, and the side that the camera is on.
    upright = float(axis @ -(poses[:, :, 1] + _FROM_ABOVE * poses[:, :, 2]).mean(axis=0))
    return axis if upright >= 0 else -axis


def _one_camera(photos: Sequence[Photo]) -> bool:
    """Whether one camera can have stood still for all of them."""
    first = photos[0]
    alike = all((photo.camera, photo.size, photo.turns) == (first.camera, first.size, first.turns) for photo in photos)
    return alike and all(photo.camera_to_world is None for photo in photos)


def _looks(photos: Sequence[Photo], most: int) -> list[_Look]:
    """Of photos spread evenly, as far as they can be read."""
    chosen = np.linspace(0, len(photos) - 1, min(most, len(photos))).round().astype(int)
    looks = []
    for number in chosen.tolist():
        try:
            looks.append(_Look.of(photos[number]))
        except CaptureError:
            continue
    return looks


def _still_behind(looks: Sequence[_Look]) -> bool:
    """Whether the border and much else that has texture stands still while something moves."""
    if len(looks) < 3:
        return False
    alike = np.mean([_alike(one, other) for one, other in combinations(looks, 2)], axis=0)
    still, textured = alike >= _STILL, np.mean([look.slope for look in looks], axis=0) > _TEXTURE**2
    height, width = alike.shape
    told = still & textured
    quarters = (told[rows, columns] for rows in _halves(height) for columns in _halves(width))
    return bool(
        still[_border(alike.shape)].mean() >= _STILL_BORDER
        and told.mean() >= _TEXTURED
        and sum(quarter.mean() >= _QUADRANT for quarter in quarters) >= 2
        and ((alike < _MOVES) & textured).mean() >= _MOVING
    )


def _halves(length: int) -> tuple[slice, slice]:
    return slice(0, length // 2), slice(length // 2, length)


def _alike(one: _Look, other: _Look) -> Bools:
    """(H,W) where two pictures differ by no more than noise and a slight shake explain; exposure does not count."""
    border = _border(one.grey.shape)
    gain = float(np.median((one.grey[border] + 1) / (other.grey[border] + 1)))
    allowed = _NOISE**2 + _SHAKE_PX**2 * (one.slope + other.slope) / 2
    return _mean((one.grey - gain * other.grey) ** 2) < _UNLIKE**2 * allowed


def _border(shape: tuple[int, ...]) -> Bools:
    """(H,W) True along the edge."""
    band = max(1, round(_BORDER * max(shape)))
    border = np.ones(shape, bool)
    border[band:-band, band:-band] = False
    return border


def _mean(values: Floats) -> Floats:
    return np.asarray(cv2.blur(values, (_WINDOW_PX, _WINDOW_PX)))


@dataclass(frozen=True, slots=True)
class _Background:
    """What stands still, as it is where nothing moves before it; known (H,W): where that was ever so."""

    look: _Look
    known: Bools

    @classmethod
    def of(cls, looks: Sequence[_Look]) -> _Background:
        """Of each pixel the look that is like most others: what moves is seldom the same twice."""
        votes = np.zeros((len(looks), *looks[0].grey.shape), np.int16)
        for one, other in combinations(range(len(looks)), 2):
            alike = _alike(looks[one], looks[other])
            votes[one] += alike
            votes[other] += alike
        border = _border(looks[0].grey.shape)
        level = float(np.median(looks[0].grey[border]))
        evened = np.stack([look.grey * (level / max(float(np.median(look.grey[border])), 1.0)) for look in looks])
        best = votes.argmax(axis=0)[None]
        grey, slope = (
            np.take_along_axis(every, best, axis=0)[0] for every in (evened, np.stack([look.slope for look in looks]))
        )
        return cls(_Look(grey, slope), votes.max(axis=0) >= _SEEN_ALIKE * len(looks))


def _masked(photo: Photo, background: _Background) -> Photo:
    try:
        look = _Look.of(photo)
    except CaptureError:
        return photo
    return replace(photo, mask=_tidy(~(_alike(look, background.look) & background.known)))


def _tidy(moving: Bools) -> Bools:
    """Without specks and holes; windows have made it wide enough."""
    mask = cv2.morphologyEx(moving.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    areas = [cv2.contourArea(outline) for outline in outlines]
    large = [outline for outline, area in zip(outlines, areas, strict=True) if area >= _PART * max(areas)]
    filled = np.zeros(moving.shape, np.uint8)
    cv2.drawContours(filled, large, -1, 1, cv2.FILLED)
    return filled.astype(bool)
