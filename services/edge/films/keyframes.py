"""Select key frames of a video: evenly spaced along the camera's path, each the sharpest of its stretch.

The path length is measured in the image: feature points are tracked from frame to frame (optical flow), and their
movement since they were detected, over the image's longer side, adds up. Standing still or shaking adds nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats

SCAN_LONGEST_PX = 640  # longer side of the scanned images: a blur that disappears at this size does not harm alignment
MIN_PATH = 0.15  # longer sides; a shorter path shows the object from one side only
MAX_KEY_FRAMES = 60  # more cost seconds each and, with 50 around an object, made the cameras no more exact
_MIN_KEY_FRAMES = 16  # for a path that is short but shows new views
_STEP = 0.05  # longer sides between two key frames
_MIDDLE = 0.6  # share of a stretch that is searched, its middle: frames from two ends that meet are too similar
_TRACKED_PX = 320  # longer side of the images in which points are tracked
_POINTS = 200  # most points to track
_SPACING_PX = 8  # least distance between two points
_STRENGTH = 4e-4  # smaller eigenvalue of a corner's gradients for intensities of 0 to 1; a wall's noise has a tenth
_RESEED_PATH = 0.05  # longer sides: new points are detected before perspective changes the look of the old ones
_RESEED_SHARE = 0.5  # of the detected points: with fewer left, new ones are detected
_MIN_TRACKED = 12  # points; fewer say nothing about the camera's movement
_THUMB = (32, 24)  # pixels, width and height of the images compared when tracking failed
# Mean difference of luma over its standard deviation, between images without a tracked point: photos from 2 degrees
# apart have 0.25, noise and the pulse of a codec's key frames on a wall below 0.1.
_OTHER_VIEW = 0.25
_UPPER = 75  # percentile of the points' movements: points of a far background move less
_STANDS = 0.004  # longer sides of movement: about 1.3 pixels of the tracked image; below it the camera stands still
_CHANGED = 12.0  # grey levels after smoothing: a rotated texture changes by more; noise and a codec's pulse by 4
_SMOOTH_PX = 1.5  # 1 sigma
_SPECK_PX = 5  # narrower changes are edges that shook
_CHANGED_SHARES = (0.004, 0.5)  # share of the image that an object turning in front of a still camera changes
_CHANGED_BORDER = 0.03  # share of the image's border: above it the camera moved, or somebody walked past
_SAME_PLACE = 0.5  # overlap of two changed regions, of the smaller: a turning object stays in its place
_BORDER_PX = 20  # width of that border
# Longer sides a second. A phone's sensor reads its lines one after the other, within a sixtieth of a second where it
# films 60 pictures in one: then the last line is 1 % of the longer side off, 19 pixels of 1,920, which no camera model
# has. A walk around a bottle in 8 s has 0.2, and 0.3 in its fastest tenth.
SWEPT = 0.6
_NARROWEST = 0.2  # longer sides: least size assumed for a turning object, which may seem smaller at first


@dataclass(frozen=True, slots=True)
class ScannedFrame:
    """Measurements of one scanned frame of a video.

    stamp      presentation time in units of the stream's time base
    sharpness  comparable between frames of about the same view
    path       length of the camera's path until this frame, in longer sides of the image
    speed      of the picture since the frame before, in longer sides a second; 0 where points could not be tracked
    """

    stamp: int
    sharpness: float
    path: float
    speed: float = 0.0


def key_frames(frames: Sequence[ScannedFrame]) -> list[ScannedFrame]:
    """Select up to MAX_KEY_FRAMES frames, in their order; none when the path is shorter than MIN_PATH."""
    if not frames or frames[-1].path < MIN_PATH:
        return []
    count = min(MAX_KEY_FRAMES, max(_MIN_KEY_FRAMES, round(frames[-1].path / _STEP)))
    paths = np.array([frame.path for frame in frames])
    centres = (np.arange(count) + 0.5) * paths[-1] / count
    reach = _MIDDLE / 2 * paths[-1] / count
    chosen = {_sharpest(frames, paths, centre, reach) for centre in centres}
    return [frames[index] for index in sorted(chosen)]


def _sharpest(frames: Sequence[ScannedFrame], paths: Floats, centre: float, reach: float) -> int:
    """Return the index of the sharpest frame within `reach` of `centre` on the path, or else of the nearest frame."""
    near = np.flatnonzero(np.abs(paths - centre) <= reach)
    if not len(near):
        return int(np.abs(paths - centre).argmin())
    return max(near.tolist(), key=lambda index: frames[index].sharpness)


def swept_share(chosen: Sequence[ScannedFrame]) -> float:
    """Return the share of the frames that a rolling shutter has bent, as the picture moved faster than SWEPT."""
    return sum(frame.speed > SWEPT for frame in chosen) / max(1, len(chosen))


def sharpness(luma: Bytes) -> float:
    """Return the mean squared difference of neighbours along rows or columns, whichever is less.

    Motion blur smears along one direction only."""
    values = luma.astype(np.float32)
    return float(min(np.square(np.diff(values, axis=axis)).mean() for axis in (0, 1)))


@dataclass(slots=True)
class PathTracker:
    """Measures the length of a camera's path from the images of a video, one after the other, by optical flow.

    Points by Jianbo Shi, Carlo Tomasi, "Good Features to Track", CVPR 1994, tracked by the pyramidal method of Bruce
    Lucas and Takeo Kanade.

    An object that turns in front of a still camera counts as a path too: only points in the region that changes are
    tracked then, and the path is measured in sizes of this region instead of the image's.

    step: how far the picture moved to the last image, in longer sides; 0 for such an object, and without points
    """

    step: float = 0.0

    _grey: Bytes | None = None
    _from: Floats = field(default_factory=lambda: np.empty((0, 1, 2), np.float32))
    _to: Floats = field(default_factory=lambda: np.empty((0, 1, 2), np.float32))
    _seed_count: int = 0
    _seed_image: Bytes | None = None
    _turning: Bools | None = None
    _path_at_seed: float = 0.0
    _path: float = 0.0

    def track(self, luma: Bytes) -> float:
        """Add the next image; return the path length until it, which never decreases.

        luma (H,W) uint8, of the same shape in every call.
        """
        grey, self.step = _shrink(luma), 0.0
        if self._grey is None:
            self._seed(grey)
        else:
            self._move(self._grey, grey)
        self._grey = grey
        return self._path

    def _move(self, last: Bytes, grey: Bytes) -> None:
        """Update the path from one image to the next, and detect new points when needed."""
        found = self._track_points(last, grey) if len(self._to) else 0
        if found < _MIN_TRACKED and self._turning is None:
            self._path_at_seed = self._path + (_RESEED_PATH if _views_differ(last, grey) else 0.0)
            self._path = self._path_at_seed
            self._seed(grey)
            return
        moved = np.linalg.norm((self._to - self._from)[:, 0], axis=1) / max(grey.shape)
        far = float(np.percentile(moved, _UPPER)) if found else 0.0
        self._path = max(self._path, self._path_at_seed + far / self._size())
        if self._path - self._path_at_seed > _RESEED_PATH or found < _RESEED_SHARE * self._seed_count:
            self._turning = self._turning_region(grey, self._turning) if self._turning is not None else None
            self._path_at_seed = self._path
            self._seed(grey)
        elif self._turning is None and far < _STANDS:
            self._turning = self._turning_region(grey, None)
            if self._turning is not None:
                self._path_at_seed = self._path
                self._seed(grey)

    def _size(self) -> float:
        """Return the size of the tracked region, in longer sides of the image: 1 unless an object turns."""
        if self._turning is None:
            return 1.0
        rows, columns = (np.flatnonzero(self._turning.any(axis=axis)) for axis in (1, 0))
        longer = max(int(np.ptp(rows)), int(np.ptp(columns)))
        return max(_NARROWEST, longer / float(max(self._turning.shape)))

    def _turning_region(self, grey: Bytes, previous: Bools | None) -> Bools | None:
        """Return the mask (H,W) of the object that turns in front of a still camera, or None if there is none.

        It is what changed since the points were detected, while the border did not; `previous` when too little changed.
        """
        assert self._seed_image is not None
        changed = _changed(self._seed_image, grey)
        inner = np.zeros(changed.shape, bool)
        inner[_BORDER_PX:-_BORDER_PX, _BORDER_PX:-_BORDER_PX] = True
        least, most = _CHANGED_SHARES
        if changed.mean() > most or changed[~inner].mean() > _CHANGED_BORDER:
            return None
        if changed.mean() < least:
            return previous
        if previous is not None and (changed & previous).sum() < _SAME_PLACE * min(changed.sum(), previous.sum()):
            return None
        return changed

    def _track_points(self, last: Bytes, grey: Bytes) -> int:
        """Track the points forward and back; drop those that do not return to their start; return the number left."""
        import cv2

        there, found, _ = cv2.calcOpticalFlowPyrLK(last, grey, self._to, None)  # type: ignore[call-overload]
        back, _, _ = cv2.calcOpticalFlowPyrLK(grey, last, there, None)  # type: ignore[call-overload]
        same = (found[:, 0] == 1) & (np.abs(back - self._to).max(axis=(1, 2)) < 1)
        if same.sum() >= _MIN_TRACKED and self._turning is None:
            moved = np.linalg.norm((there - self._to)[same][:, 0], axis=1)
            self.step = float(np.percentile(moved, _UPPER)) / max(grey.shape)
        self._from, self._to = self._from[same], there[same]
        return int(same.sum())

    def _seed(self, grey: Bytes) -> None:
        """Detect new points to track, in the turning region if there is one."""
        import cv2

        strength = cv2.cornerMinEigenVal(grey.astype(np.float32) / 255, 3)
        wanted = strength > _STRENGTH if self._turning is None else (strength > _STRENGTH) & self._turning
        points = cv2.goodFeaturesToTrack(grey, _POINTS, 0.01, _SPACING_PX, mask=wanted.astype(np.uint8))
        self._from = np.empty((0, 1, 2), np.float32) if points is None else np.asarray(points, np.float32)
        self._to, self._seed_count, self._seed_image = self._from, len(self._from), grey


def _shrink(luma: Bytes) -> Bytes:
    """Downscale an image to at most _TRACKED_PX along its longer side."""
    import cv2

    height, width = luma.shape
    shrink = max(1.0, max(luma.shape) / _TRACKED_PX)
    size = max(1, round(width / shrink)), max(1, round(height / shrink))
    return np.asarray(cv2.resize(luma, size, interpolation=cv2.INTER_AREA), np.uint8)


def _views_differ(last: Bytes, grey: Bytes) -> bool:
    """Return whether two images show different views, by their thumbnails; a change of exposure does not count."""
    one, other = (_thumb(picture) for picture in (last, grey))
    return float(np.abs(one - other).mean()) > _OTHER_VIEW * max(float(one.std()), 1.0)


def _changed(before: Bytes, now: Bytes) -> Bools:
    """Return the mask (H,W) where two images differ by more than exposure and noise."""
    import cv2

    one, other = (cv2.GaussianBlur(grey.astype(np.float32), (0, 0), _SMOOTH_PX) for grey in (before, now))
    apart = one - other
    changed = (np.abs(apart - np.median(apart)) > _CHANGED).astype(np.uint8)
    changed = cv2.morphologyEx(changed, cv2.MORPH_OPEN, np.ones((_SPECK_PX, _SPECK_PX), np.uint8))
    kernel = np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _SPACING_PX + 1,) * 2))
    return np.asarray(cv2.morphologyEx(changed, cv2.MORPH_CLOSE, kernel), np.bool_)


def _thumb(grey: Bytes) -> Floats:
    """Return a thumbnail (24,32) float32 with mean 0."""
    import cv2

    small = np.asarray(cv2.resize(grey, _THUMB, interpolation=cv2.INTER_AREA), np.float32)
    return np.asarray(small - small.mean(), np.float32)
