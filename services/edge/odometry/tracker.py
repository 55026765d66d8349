"""RGB-D odometry: compute the poses of depth frames by aligning them with key frames, with loop closure.

1. track     align every frame with the current key frame, from a guess of constant motion; where that fails, from
             matched image features
2. key       a frame that overlaps its key frame too little, or has moved too far, becomes the next key frame
3. close     align key frames that are not neighbours but see the same surface, by their poses or by their pictures
4. optimise  fit the key frames' poses to all of these alignments; the other frames move with their key frame; then 3
             again, as long as that brings others together
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats, Tick, no_tick, part_of
from capture2vr.edge.capture.nouns import Frame
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.fusion.depth_range import survey_frames
from capture2vr.edge.fusion.observe import at_resolution
from capture2vr.edge.odometry.icp import MIN_PAIRS, IcpFit, align
from capture2vr.edge.odometry.loop_closure import close_loops
from capture2vr.edge.odometry.pose_graph import Edge
from capture2vr.edge.odometry.pyramid import PackedLevel, PyramidLevel, pyramid
from capture2vr.edge.odometry.relocalise import relocalise
from capture2vr.edge.points.depth_limits import DepthLimits
from capture2vr.edge.points.frame_faults import FrameFaults
from capture2vr.sentences.sentence import say

_MAX_SIDE = 320
"""Longer side, in pixels, at which frames are aligned: at 640 the pose is no better and takes four times as long."""
_BLUR_PX = 1.5
"""Standard deviation of the blur that removes the noise from the picture's gradients."""
_KEY_OVERLAP = 0.75
_KEY_TURN_DEG = 15.0
_KEY_SHIFT = 0.15
"""A frame that overlaps its key frame less than this, or has turned or moved (in shares of the median depth) further,
becomes the next key frame: beyond that, many pixels project to the few pixels of a slanted surface."""
_MAX_LOST = 30
"""Lost frames in a row after which tracking stops: a second at video rate, after which the camera may be elsewhere."""
_MIN_TRACKED = 0.5
"""Least share of the frames that must be tracked; fewer do not show the whole object."""
_SURE = 0.97
"""Agreement of a fit that is taken as it is; below it, features give a guess of their own, and the better fit counts.
On a wall whose pattern repeats, a guess that is off by a few degrees, as where the camera begins to turn, ends up a
whole period away, with an agreement of 0.93 to 0.96; right fits of phones' depth have 0.97 and more."""
_RELOCALISATION_KEYS = 3
"""Most key frames, the newest first, against which a lost camera is relocalised."""


@dataclass(frozen=True, slots=True)
class TrackedFrames:
    """Result of the odometry.

    frames: those that could be tracked, with poses in the first one's axes; warnings: sentences for the report.
    """

    frames: tuple[Frame, ...]
    warnings: tuple[str, ...]


def track_frames(frames: Sequence[Frame], tick: Tick = no_tick) -> TrackedFrames:
    """Compute the poses of depth frames, in metres and in the axes of the first tracked frame's camera.

    One frame is in memory at a time, and a third of a megabyte per key frame; time grows with the number of frames.
    Raises CaptureError: CAPTURE_NO_POSES where less than half can be tracked, naming the first lost frame;
    CAPTURE_TOO_FEW_POINTS where there is hardly any depth. `tick` may raise `Cancelled`.
    """
    faults = FrameFaults()
    way = follow_frames(frames, faults, part_of(tick, 0, 0.7))
    _require_tracked(frames, way)
    closed = close_loops(way.keys, np.stack(way.poses), way.edges, part_of(tick, 0.7, 1.0))
    return TrackedFrames(way.posed(frames, closed.poses), _lost_warning(frames, way) + faults.warnings(len(frames)))


def follow_frames(frames: Sequence[Frame], faults: FrameFaults, tick: Tick = no_tick) -> CameraWay:
    """Follow the camera from frame to frame, without closing loops; ends where it is lost for good."""
    limits = survey_frames(frames).limits
    way = CameraWay()
    for number, frame in enumerate(frames):
        level = _level(frame, limits, faults)
        if level is not None:
            way.track(number, level)
        if way.lost_in_a_row(number) > _MAX_LOST:
            break
        tick((number + 1) / len(frames))
    return way


class CameraWay:
    """The camera's path so far.

    keys, poses  the key frames and their (4,4) camera-to-world poses
    edges        measured poses between each key frame and the one before
    places       frame number -> (index of its key frame, its pose (4,4) in that key frame)
    """

    def __init__(self) -> None:
        self.keys: list[PackedLevel] = []
        self.poses: list[Floats] = []
        self.edges: list[Edge] = []
        self.places: dict[int, tuple[int, Floats]] = {}
        self._key: tuple[PyramidLevel, ...] = ()
        self._newest: int | None = None
        self._last_pose = self._motion = np.eye(4)

    def track(self, number: int, level: PyramidLevel) -> None:
        """Track frame `number`; a frame that cannot be tracked changes nothing but the assumed motion."""
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
        self._motion, self._last_pose = np.linalg.inv(self._last_pose) @ pose, pose
        self._place(number, key, fit.pose)
        if _is_next_key(fit, level):
            self.edges.append(Edge(key, len(self.keys), fit.pose, fit.information))
            self._add_key(number, levels, pose)

    def lost_in_a_row(self, number: int) -> int:
        """Return how many frames up to `number` are lost since the last tracked one."""
        return 0 if self._newest is None else number - self._newest

    def posed(self, frames: Sequence[Frame], poses: Floats) -> tuple[Frame, ...]:
        """Return the tracked frames with their poses, given the key frames' (K,4,4)."""
        return tuple(
            replace(frames[at], camera_to_world=poses[key] @ inside) for at, (key, inside) in self.places.items()
        )

    def _place(self, number: int, key: int, inside: Floats) -> None:
        self.places[number], self._newest = (key, inside), number

    def _add_key(self, number: int, levels: tuple[PyramidLevel, ...], pose: Floats) -> None:
        """Make frame `number` the newest key frame."""
        self._place(number, len(self.keys), np.eye(4))
        self.keys.append(PackedLevel.of(levels[-1]))
        self.poses.append(pose)
        self._key = levels

    def _find(self, levels: tuple[PyramidLevel, ...]) -> tuple[int, IcpFit] | None:
        """Align a frame with a key frame, usually the newest; return the key frame's index and the fit, or None."""
        newest = len(self.keys) - 1
        to_key = np.linalg.inv(self.poses[newest])
        fits = []
        for guess in (self._last_pose @ self._motion, self._last_pose):
            fit = align(levels, self._key, to_key @ guess)
            if fit is not None and fit.sound:
                fits.append((newest, fit))
                if fit.agreement > _SURE:
                    return newest, fit
        return max(fits + self._relocalise(levels, 1 if fits else _RELOCALISATION_KEYS), key=_agreement, default=None)

    def _relocalise(self, levels: tuple[PyramidLevel, ...], most: int) -> list[tuple[int, IcpFit]]:
        """Align a frame by features with the first of the `most` newest key frames that it fits; at most one fit."""
        newest = len(self.keys) - 1
        for key in range(newest, max(newest - most, -1), -1):
            fit = relocalise(levels, self.keys[key].unpacked())
            if fit is not None:
                return [(key, fit)]
        return []


def _agreement(found: tuple[int, IcpFit]) -> float:
    return found[1].agreement


def _is_next_key(fit: IcpFit, level: PyramidLevel) -> bool:
    """Return whether a frame, aligned like this with its key frame, should become the next key frame."""
    turn = np.degrees(np.arccos(np.clip((np.trace(fit.pose[:3, :3]) - 1) / 2, -1, 1)))
    q = level.inverse_depth
    shift = float(np.linalg.norm(fit.pose[:3, 3]) * np.median(q[q > 0]))
    return fit.overlap < _KEY_OVERLAP or turn > _KEY_TURN_DEG or shift > _KEY_SHIFT


def _level(frame: Frame, limits: DepthLimits, faults: FrameFaults) -> PyramidLevel | None:
    """Load a frame's filtered depth and its grey picture, at most _MAX_SIDE pixels along the longer side.

    None where the depth cannot be decoded."""
    view = faults.read_view(replace(frame, camera_to_world=np.eye(4)), limits)
    if view is None:
        return None
    level = PyramidLevel(
        view.intrinsics, view.inverse_depth, _grey(faults.read_picture(frame), view.inverse_depth.shape)
    )
    while max(level.inverse_depth.shape) > _MAX_SIDE:
        level = level.half_size()
    return level


def _grey(rgb: Bytes | None, shape: tuple[int, ...]) -> Floats | None:
    """Convert a picture to blurred grey (H,W) float32 0..1; None without a picture."""
    import cv2

    if rgb is None:
        return None
    grey = cv2.cvtColor(at_resolution(rgb, shape), cv2.COLOR_RGB2GRAY).astype(np.float32) / 255
    return np.asarray(cv2.GaussianBlur(grey, (0, 0), _BLUR_PX), np.float32)


def _require_tracked(frames: Sequence[Frame], way: CameraWay) -> None:
    """Raise CAPTURE_NO_POSES when too few frames were tracked."""
    if len(way.places) >= max(_MIN_TRACKED * len(frames), min(2, len(frames))):
        return
    lost = _lost(frames, way)
    raise CaptureError(
        "CAPTURE_NO_POSES",
        say("recording_has_no_camera_poses", count=len(way.places), frames=len(frames)),
        file=frames[lost[0]].name,
        hints=(
            say("move_slowly_so_each_frame"),
            say("keep_corners_things_in_view"),
            say("send_camera_poses_scanning_app"),
        ),
    )


def _lost(frames: Sequence[Frame], way: CameraWay) -> list[int]:
    """Return the numbers of the frames that were not tracked."""
    return [number for number in range(len(frames)) if number not in way.places]


def _lost_warning(frames: Sequence[Frame], way: CameraWay) -> tuple[str, ...]:
    lost = _lost(frames, way)
    if not lost:
        return ()
    return (say("tracking_lost_frames_left", name=frames[lost[0]].name, count=len(lost), frames=len(frames)),)
