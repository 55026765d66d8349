"""Scan a video once at a small size, for sharpness and camera movement, for at most DEADLINE_S of decoding."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from capture2vr.edge.arrays import Bytes, Tick, no_tick
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.films.keyframes import SCAN_LONGEST_PX, PathTracker, ScannedFrame, sharpness
from capture2vr.edge.films.video_streams import (
    FrameIndex,
    Skip,
    Sphere,
    VideoStream,
    decode_packet,
    open_video,
    read_index,
    sphere_of,
)
from capture2vr.sentences.sentence import say

SKIP: Skip = "NONREF"  # non-reference frames: half of the frames of a phone's video; decoding takes half the time
DEADLINE_S = 40.0  # seconds of decoding for any video; what was scanned until then is used
_SAMPLE_S = 1 / 15  # seconds between two scanned frames: four for each photo of a walk of 10 s
_MAX_SAMPLES = 900  # scanned frames of a long video, at 12 ms each
_BUDGET = 4e9  # pixels to decode, 10 to 20 s on two cores: a minute of 1920 x 1080, a quarter minute of 3840 x 2160
_LONGEST_GROUP_S = 2.5  # seconds between the codec's key frames, up to which only the start of a group may be decoded
_TAIL_S = 1.0  # seconds by which a video may be shorter than its header says


@dataclass(slots=True)
class VideoScan:
    """Result of scanning a video.

    index     stamps of all frames
    frames    the scanned frames, in display order
    turns     as in `Photo`
    sphere    how the frames show all sides; None where they are those of an ordinary lens
    end_s     time of the last frame that was decoded
    broken_s  time of the first damaged packet, or None
    late      whether the deadline ended the scan
    """

    stream: VideoStream
    index: FrameIndex
    frames: list[ScannedFrame] = field(default_factory=list)
    turns: int = 0
    sphere: Sphere | None = None
    end_s: float = 0.0
    broken_s: float | None = None
    late: bool = False

    def seconds(self, stamp: int) -> float:
        """Convert a presentation timestamp to seconds since the first frame."""
        return float((stamp - self.index.stamps[0]) * self.stream.film.time_base)

    def run(self, tick: Tick) -> None:
        """Decode the video once and measure sharpness and motion of frames sampled at equal steps."""
        tracker, due, every = PathTracker(), 0.0, max(_SAMPLE_S, self._length_s() / _MAX_SAMPLES)
        last = -math.inf
        for frame in self._decoded_frames():
            at = self.seconds(frame.pts)
            self.end_s = max(self.end_s, at)
            tick(min(1.0, self.end_s / max(self._length_s(), 1e-9)))
            if at >= due:
                due = at + 0.99 * every  # stamps are rounded
                luma = _luma(frame, self.stream.size)
                self.turns, self.sphere = round(-frame.rotation / 90) % 4, sphere_of(frame)
                path, last, seconds = tracker.track(luma), at, at - last
                self.frames.append(ScannedFrame(frame.pts, sharpness(luma), path, tracker.step / max(seconds, 1e-3)))

    def _decoded_frames(self) -> Iterator[Any]:
        """Decode frames in display order until the deadline.

        After a damaged packet it skips to the next key frame: frames that refer to the damaged one are damaged too."""
        ends, healthy = time.monotonic() + DEADLINE_S, True
        for packet in self._packets():
            if time.monotonic() > ends:
                self.late = True
                return
            frames = decode_packet(packet)
            if frames is None:
                healthy = False
                self._note_damage(packet)
            for frame in frames or ():
                healthy = healthy or frame.key_frame
                if healthy and frame.pts is not None:
                    yield frame

    def _note_damage(self, packet: Any) -> None:
        if self.broken_s is None:
            self.broken_s = self.end_s if packet.pts is None else self.seconds(packet.pts)

    def _packets(self) -> Iterator[Any]:
        """Iterate over the packets to decode: all, or for a long video the start of each group of pictures.

        A group is left in decoding order, so that no decoded frame refers to a packet that is left out."""
        group_s, key, begun = self._group_s(), self.index.stamps[0], True
        if math.isinf(group_s):
            yield from self.stream.packets()
            return
        for packet in self.stream.packets():
            if packet.pts is None:
                yield packet
                continue
            if packet.is_keyframe:
                key, begun = packet.pts, True
            since_s = self.seconds(packet.pts) - self.seconds(key)
            begun = begun and since_s <= group_s
            if begun and since_s >= 0:  # a frame shown before its key frame refers to the previous group
                yield packet

    def _group_s(self) -> float:
        """Return the seconds after each key frame that are decoded, so that the cost stays within _BUDGET; inf: all."""
        cost = len(self.index.stamps) * math.prod(self.stream.size)
        keys = [*map(self.seconds, self.index.keys), self._length_s()]
        longest_s = float(np.diff(keys).max(initial=0))
        return longest_s * _BUDGET / cost if cost > _BUDGET and 0 < longest_s <= _LONGEST_GROUP_S else math.inf

    def _length_s(self) -> float:
        return self.seconds(self.index.stamps[-1])

    def faults(self, name: str) -> tuple[str, ...]:
        """Return a warning about the part of the video that could not be decoded, if any."""
        header_s = self.stream.duration_s
        if self.late:
            reason = say("only_first_s_s_decoded", seconds=self.end_s, length=self._length_s())
            return (say("reason_then_film_minute", name=name, reason=reason),)
        if self.broken_s is not None:
            return (say("damaged_s_only_parts", name=name, seconds=self.broken_s),)
        if self._length_s() < header_s - _TAIL_S:
            return (say("cut_off_s_s_part", name=name, seconds=self._length_s(), length=header_s),)
        return ()


def scan_video(path: Path, name: str, tick: Tick = no_tick) -> VideoScan:
    """Scan a video file. Raises CAPTURE_EMPTY, CAPTURE_UNREADABLE, CAPTURE_TOO_LARGE and IMAGE_TOO_LARGE."""
    index = read_index(open_video(path, name), name)
    if not index.stamps:
        raise CaptureError("CAPTURE_EMPTY", say("video_without_frames"), file=name, hints=(say("film_thing_again"),))
    scan = VideoScan(open_video(path, name, SKIP), index)
    scan.run(tick)
    return scan


def _luma(frame: Any, size: tuple[int, int]) -> Bytes:
    """Return a frame's luma (H,W) uint8, scaled to the scan's size whatever the frame's own size is."""
    shrink = max(1.0, max(size) / SCAN_LONGEST_PX)
    width, height = (max(1, round(side / shrink)) for side in size)
    return np.asarray(frame.reformat(width, height, format="gray", interpolation="AREA").to_ndarray(), np.uint8)
