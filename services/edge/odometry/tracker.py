"""Depth frames without poses -> posed frames: each is aligned with a key frame, and key frames that meet again with
each other.

1. track   every frame against the current key frame, from where the last motion would take it; where that fails, from
           matched picture features
2. key     a frame that shares too little with its key frame, or has moved too far, is the next key frame
3. close   key frames that are no neighbours and look at one surface are aligned too
4. settle  the key frames' poses are fitted to all of these; the other frames move with their key frame
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from services.edge.arrays import Floats, Tick, no_tick
from services.edge.capture.nouns import Frame
from services.edge.errors import CaptureError
from services.edge.points.depth import Limits, read_view
from services.edge.points.fuse import at_resolution
from services.edge.points.icp import MIN_PAIRS, Fit, align
from services.edge.points.levels import Level, pyramid
from services.edge.points.loops import close_loops
from services.edge.points.posegraph import Edge, settle
from services.edge.points.recognise import recognise
from services.edge.points.survey import survey_frames

_MAX_SIDE = 320
"""Pixels of the longer side that are aligned: at 640 the pose is no better and takes four times as long."""
_BLUR_PX = 1.5
"""Standard deviation of the blur that takes the noise off the picture's gradients."""
_KEY_OVERLAP = 0.75
_KEY_TURN_DEG = 15.0
_KEY_SHIFT = 0.15
"""A frame that shares less than this with its key frame, or has turned or moved (in shares of the median depth)
further, is the next: pixels then fall on a slanted surface's few."""
_MAX_LOST = 30
"""Frames lost in a row after which the rest is not tried: a second at video rate, and somebody may have walked on."""
_MIN_TRACKED = 0.5
"""Share of the frames that must be tracked; less is no picture of the thing."""
_KEYS_TO_ASK = 3
"""Key frames among which a lost camera is looked for, the newest first."""


@dataclass(frozen=True, slots=True)
class Tracked:
    """frames: those that could be tracked, with poses in the first one's axes; warnings: sentences for the report."""

    frames: tuple[Frame, ...]
    warnings: tuple[str, ...]


def track_frames(frames: Sequence[Frame], tick: Tick = no_tick) -> Tracked:
    """Give frames without poses theirs, in metres and in the axes of the first tracked frame's camera.

    One frame is in memory at a time, and half a megabyte per key frame. Raises CaptureError: CAPTURE_NO_POSES where
    less than half can be tracked, naming the frame at which it ended; CAPTURE_TOO_FEW_POINTS where there is hardly any
    depth. `tick` may raise `Cancelled`.
    """
    limits = survey_frames(frames).limits
    walk = _Walk()
    for number, frame in enumerate(frames):
        walk.see(number, _level(frame, limits))
        if walk.lost_in_a_row(number) > _MAX_LOST:
            break
        tick(0.7 * (number + 1) / len(frames))
    _require_tracked(frames, walk)
    loops = close_loops(walk.keys, np.stack(walk.poses), lambda part: tick(0.7 + 0.28 * part))
    poses = settle(np.stack(walk.poses), walk.edges + loops)
    tick(1.0)
    posed = (replace(frames[at], camera_to_world=poses[key] @ inside) for at, (key, inside) in walk.places.items())
    return Tracked(tuple(posed), _lost_warning(frames, walk))


class _Walk:
    """The way of the camera so far.

    keys, poses  the key frames and their (4,4) camera-to-world; edges: between each and the one before
    places       frame number -> (its key frame, pose (4,4) in it)
    """

    def __init__(self) -> None:
        self.keys: list[Level] = []
        self.poses: list[Floats] = []
        self.edges: list[Edge] = []
        self.places: dict[int, tuple[int, Floats]] = {}
        self._key: tuple[Level, ...] = ()
        self._here = self._motion = np.eye(4)

    def see(self, number: int, level: Level) -> None:
        """Place the frame `number`; a frame that cannot be placed leaves no trace."""
        if np.count_nonzero(level.inverse_depth) < MIN_PAIRS:
            return
        levels = pyramid(level)
        if not self.keys:
            self._add_key(number, levels, np.eye(4))
            return
        found = self._find(levels)
        if found is None:
            self._motion = np.eye(4)
            return
        key, fit = found
        pose = self.poses[key] @ fit.pose
        self._motion, self._here = np.linalg.inv(self._here) @ pose, pose
        self.places[number] = (key, fit.pose)
        if _moved_on(fit, level):
            self.edges.append(Edge(key, len(self.keys), fit.pose, fit.information))
            self._add_key(number, levels, pose)

    def lost_in_a_row(self, number: int) -> int:
        """Frames up to `number` since the last one with a place."""
        return number - max(self.places, default=number)

    def _add_key(self, number: int, levels: tuple[Level, ...], pose: Floats) -> None:
        self.places[number] = (len(self.keys), np.eye(4))
        self.keys.append(replace(levels[-1]))  # without what it has worked out: that is five times its size
        self.poses.append(pose)
        self._key = levels

    def _find(self, levels: tuple[Level, ...]) -> tuple[int, Fit] | None:
        """The key frame, usually the newest, that the frame fits, and how."""
        newest = len(self.keys) - 1
        to_key = np.linalg.inv(self.poses[newest])
        for guess in (self._here @ self._motion, self._here):
            fit = align(levels, self._key, to_key @ guess)
            if fit is not None and fit.sound:
                return newest, fit
        for key in range(newest, max(newest - _KEYS_TO_ASK, -1), -1):
            fit = recognise(levels, self.keys[key])
            if fit is not None:
                return key, fit
        return None


def _moved_on(fit: Fit, level: Level) -> bool:
    """Whether a frame that fits its key frame so should be the next key frame."""
    turn = np.degrees(np.arccos(np.clip((np.trace(fit.pose[:3, :3]) - 1) / 2, -1, 1)))
    q = level.inverse_depth
    shift = float(np.linalg.norm(fit.pose[:3, 3]) * np.median(q[q > 0]))
    return fit.overlap < _KEY_OVERLAP or turn > _KEY_TURN_DEG or shift > _KEY_SHIFT


def _level(frame: Frame, limits: Limits) -> Level:
    """The frame's believed depth and its picture in grey, at most _MAX_SIDE pixels long."""
    view = read_view(replace(frame, camera_to_world=np.eye(4)), limits)
    level = Level(view.intrinsics, view.inverse_depth, _grey(frame, view.inverse_depth.shape))
    while max(level.inverse_depth.shape) > _MAX_SIDE:
        level = level.halved()
    return level


def _grey(frame: Frame, shape: tuple[int, ...]) -> Floats | None:
    import cv2

    if frame.load_rgb is None:
        return None
    grey = cv2.cvtColor(at_resolution(frame.load_rgb(), shape), cv2.COLOR_RGB2GRAY).astype(np.float32) / 255
    return np.asarray(cv2.GaussianBlur(grey, (0, 0), _BLUR_PX), np.float32)


def _require_tracked(frames: Sequence[Frame], walk: _Walk) -> None:
    if len(walk.places) >= max(_MIN_TRACKED * len(frames), min(2, len(frames))):
        return
    lost = _lost(frames, walk)
    raise CaptureError(
        "CAPTURE_NO_POSES",
        f"has no poses, and its frames do not tell them: {len(walk.places)} of {len(frames)} could be tracked",
        file=frames[lost[0]].name,
        hints=(
            "Move slowly, so that each frame shows most of what the last one showed.",
            "Keep corners and things in view, not only a bare wall or floor.",
            "Or send the poses of the app or the tracker too.",
        ),
    )


def _lost(frames: Sequence[Frame], walk: _Walk) -> list[int]:
    return [number for number in range(len(frames)) if number not in walk.places]


def _lost_warning(frames: Sequence[Frame], walk: _Walk) -> tuple[str, ...]:
    lost = _lost(frames, walk)
    if not lost:
        return ()
    return (
        f"Tracking was lost at {frames[lost[0]].name}: {len(lost)} of {len(frames)} frames were left out."
        " Move slowly and keep corners in view.",
    )
