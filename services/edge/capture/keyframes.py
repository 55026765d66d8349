"""Which frames of a film become photos: evenly spread along the way that the camera went, the sharpest of each stretch.

The way is measured in the picture: points are followed from frame to frame, and how far they have moved since they
were first seen, as a share of the picture's longer side, adds up. A camera that waits or trembles gets no further.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from services.edge.arrays import Bools, Bytes, Floats

LONGEST = 640  # pixels of the pictures that are judged: what is blurred by less is sharp enough to be aligned
STILL = 0.15  # of the longer side: a way below it shows the thing from one side
MOST = 60  # photos; more cost seconds each and, with 50 round a thing, made cameras no more exact
_FEWEST = 16  # photos of a way that is short and shows something new all the same
_STEP = 0.05  # of the longer side, between two photos
_MIDDLE = 0.6  # of a stretch, in which its photo is looked for: neighbours from ends that meet are too alike
_FOLLOWED_PX = 320  # longer side of the pictures in which points are followed
_POINTS = 200
_APART_PX = 8
_STRENGTH = 4e-4  # smaller eigenvalue of a corner's gradients for intensities of 0 to 1; a wall's noise has a tenth
_RENEWED = 0.05  # of the longer side: new points are looked for before perspective makes the old ones unlike
_LOST = 0.5  # of the points: with fewer left, new ones are looked for
_TOO_FEW = 12  # points that tell nothing of the camera
_THUMB = (32, 24)
# Mean difference of luma over its standard deviation, between pictures of which no point was found again: photos from
# 2 degrees apart have 0.25, noise and a codec's pulse on a wall below 0.1.
_OTHER_VIEW = 0.25
_UPPER = 75  # percentile of the points' ways: those of a far background are short
_STANDS = 0.004  # of the longer side: a pixel and a bit of what is followed
_CHANGED = 12.0  # grey levels after smoothing, of a turned texture; noise and a codec's pulse have 4
_SMOOTH_PX = 1.5  # 1 sigma
_SPECK_PX = 5  # narrower changes are edges that trembled
_CHANGED_SHARES = (0.004, 0.5)  # of the picture, that turn before a camera that stands still
_CHANGED_BORDER = 0.03  # share of the picture's border: more, and the camera moved, or somebody walked past
_SAME_PLACE = 0.5  # share of what changed, or of what changed before, that both have: what turns stays where it is
_BORDER_PX = 20
_NARROWEST = 0.2  # of the longer side: what turns may seem smaller at first


@dataclass(frozen=True, slots=True)
class Look:
    """What is kept of a frame. way: of the camera until then, in longer sides of the picture; sharpness: for frames of
    about the same view."""

    stamp: int
    sharpness: float
    way: float


def key_frames(looks: Sequence[Look]) -> list[Look]:
    """Up to MOST of them, in their order; none where the way is shorter than STILL."""
    if not looks or looks[-1].way < STILL:
        return []
    count = min(MOST, max(_FEWEST, round(looks[-1].way / _STEP)))
    ways = np.array([look.way for look in looks])
    centres = (np.arange(count) + 0.5) * ways[-1] / count
    reach = _MIDDLE / 2 * ways[-1] / count
    chosen = {_sharpest(looks, ways, centre, reach) for centre in centres}
    return [looks[index] for index in sorted(chosen)]


def _sharpest(looks: Sequence[Look], ways: Floats, centre: float, reach: float) -> int:
    near = np.flatnonzero(np.abs(ways - centre) <= reach)
    if not len(near):
        return int(np.abs(ways - centre).argmin())
    return max(near.tolist(), key=lambda index: looks[index].sharpness)


def sharpness(luma: Bytes) -> float:
    """Mean squared difference of neighbours along rows or columns, whichever is less: smears go one way."""
    values = luma.astype(np.float32)
    return float(min(np.square(np.diff(values, axis=axis)).mean() for axis in (0, 1)))


@dataclass(slots=True)
class Follower:
    """The way of a camera, told from its pictures one after the other.

    Points by Jianbo Shi, Carlo Tomasi, "Good Features to Track", CVPR 1994, followed by pyramids of Bruce Lucas' and
    Takeo Kanade's method.

    A camera that stands still before a turning thing gets somewhere too: only what changes is followed then, and the
    way is told in sizes of it instead of the picture's.
    """

    _grey: Bytes | None = None
    _from: Floats = field(default_factory=lambda: np.empty((0, 1, 2), np.float32))
    _to: Floats = field(default_factory=lambda: np.empty((0, 1, 2), np.float32))
    _seeded: int = 0
    _seen: Bytes | None = None
    _turning: Bools | None = None
    _before: float = 0.0
    _way: float = 0.0

    def follow(self, luma: Bytes) -> float:
        """The way until this picture, at least that until the last one. luma (H,W) uint8, of always the same shape."""
        grey = _shrunk(luma)
        if self._grey is None:
            self._seed(grey)
        else:
            self._move(self._grey, grey)
        self._grey = grey
        return self._way

    def _move(self, last: Bytes, grey: Bytes) -> None:
        found = self._found(last, grey) if len(self._to) else 0
        if found < _TOO_FEW and self._turning is None:
            self._before = self._way + (_RENEWED if _differ(last, grey) else 0.0)
            self._way = self._before
            self._seed(grey)
            return
        moved = np.linalg.norm((self._to - self._from)[:, 0], axis=1) / max(grey.shape)
        far = float(np.percentile(moved, _UPPER)) if found else 0.0
        self._way = max(self._way, self._before + far / self._size())
        if self._way - self._before > _RENEWED or found < _LOST * self._seeded:
            self._turning = self._turns_now(grey, self._turning) if self._turning is not None else None
            self._before = self._way
            self._seed(grey)
        elif self._turning is None and far < _STANDS:
            self._turning = self._turns_now(grey, None)
            if self._turning is not None:
                self._before = self._way
                self._seed(grey)

    def _size(self) -> float:
        """Of what is followed, in longer sides of the picture."""
        if self._turning is None:
            return 1.0
        rows, columns = (np.flatnonzero(self._turning.any(axis=axis)) for axis in (1, 0))
        longer = max(int(np.ptp(rows)), int(np.ptp(columns)))
        return max(_NARROWEST, longer / float(max(self._turning.shape)))

    def _turns_now(self, grey: Bytes, until_now: Bools | None) -> Bools | None:
        """(H,W) what has changed since the points were seeded, within a border that has not; `until_now` where that is
        too little; None where it was not something that turns."""
        assert self._seen is not None
        changed = _changed(self._seen, grey)
        inner = np.zeros(changed.shape, bool)
        inner[_BORDER_PX:-_BORDER_PX, _BORDER_PX:-_BORDER_PX] = True
        least, most = _CHANGED_SHARES
        if changed.mean() > most or changed[~inner].mean() > _CHANGED_BORDER:
            return None
        if changed.mean() < least:
            return until_now
        if until_now is not None and (changed & until_now).sum() < _SAME_PLACE * min(changed.sum(), until_now.sum()):
            return None
        return changed

    def _found(self, last: Bytes, grey: Bytes) -> int:
        """Follow the points there and back; those that come back elsewhere were lost."""
        import cv2

        there, found, _ = cv2.calcOpticalFlowPyrLK(last, grey, self._to, None)  # type: ignore[call-overload]
        back, _, _ = cv2.calcOpticalFlowPyrLK(grey, last, there, None)  # type: ignore[call-overload]
        same = (found[:, 0] == 1) & (np.abs(back - self._to).max(axis=(1, 2)) < 1)
        self._from, self._to = self._from[same], there[same]
        return int(same.sum())

    def _seed(self, grey: Bytes) -> None:
        import cv2

        strength = cv2.cornerMinEigenVal(grey.astype(np.float32) / 255, 3)
        wanted = strength > _STRENGTH if self._turning is None else (strength > _STRENGTH) & self._turning
        points = cv2.goodFeaturesToTrack(grey, _POINTS, 0.01, _APART_PX, mask=wanted.astype(np.uint8))
        self._from = np.empty((0, 1, 2), np.float32) if points is None else np.asarray(points, np.float32)
        self._to, self._seeded, self._seen = self._from, len(self._from), grey


def _shrunk(luma: Bytes) -> Bytes:
    import cv2

    height, width = luma.shape
    shrink = max(1.0, max(luma.shape) / _FOLLOWED_PX)
    size = max(1, round(width / shrink)), max(1, round(height / shrink))
    return np.asarray(cv2.resize(luma, size, interpolation=cv2.INTER_AREA), np.uint8)


def _differ(last: Bytes, grey: Bytes) -> bool:
    """Whether two pictures are of different views, by their coarse tones; exposure may have changed between them."""
    one, other = (_thumb(picture) for picture in (last, grey))
    return float(np.abs(one - other).mean()) > _OTHER_VIEW * max(float(one.std()), 1.0)


def _changed(before: Bytes, now: Bytes) -> Bools:
    """(H,W) where two pictures differ, but for their exposure and for noise."""
    import cv2

    one, other = (cv2.GaussianBlur(grey.astype(np.float32), (0, 0), _SMOOTH_PX) for grey in (before, now))
    apart = one - other
    changed = (np.abs(apart - np.median(apart)) > _CHANGED).astype(np.uint8)
    changed = cv2.morphologyEx(changed, cv2.MORPH_OPEN, np.ones((_SPECK_PX, _SPECK_PX), np.uint8))
    kernel = np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _APART_PX + 1,) * 2))
    return np.asarray(cv2.morphologyEx(changed, cv2.MORPH_CLOSE, kernel), np.bool_)


def _thumb(grey: Bytes) -> Floats:
    """(24,32) float32, around 0."""
    import cv2

    small = np.asarray(cv2.resize(grey, _THUMB, interpolation=cv2.INTER_AREA), np.float32)
    return np.asarray(small - small.mean(), np.float32)
