"""One pass through a film at a small size, as fast as it decodes and no longer than DEADLINE_S."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from services.edge.arrays import Bytes, Tick, no_tick
from services.edge.capture.keyframes import LONGEST, Follower, Look, sharpness
from services.edge.capture.streams import Skip, Stream, Table, decoded, open_video, read_table
from services.edge.errors import CaptureError

SKIP: Skip = "NONREF"  # half of the frames that a phone films; without them it goes twice as fast
DEADLINE_S = 40.0  # seconds of decoding, whatever the film is; what was seen until then is used
_LOOK_S = 1 / 15  # seconds between two looks: four for each photo of a walk of 10 s
_LOOKS = 900  # of a long film, at 12 ms each
_BUDGET = 4e9  # pixels to decode, 10 to 20 s on two cores: a minute of 1920 x 1080, a quarter of one of 3840 x 2160
_LONGEST_GROUP_S = 2.5  # seconds between the codec's key frames, where only the beginning of each group is looked at
_TAIL_S = 1.0  # by which a film may be shorter than its header says


@dataclass(slots=True)
class Viewing:
    """What is seen in a film.

    looks: in display order; turns: as `Photo` has them; end_s: time of the last frame; broken_s: of the first damage;
    late: whether the time for it ran out.
    """

    stream: Stream
    table: Table
    looks: list[Look] = field(default_factory=list)
    turns: int = 0
    end_s: float = 0.0
    broken_s: float | None = None
    late: bool = False

    def seconds(self, stamp: int) -> float:
        """Since the first frame."""
        return float((stamp - self.table.stamps[0]) * self.stream.film.time_base)

    def watch(self, tick: Tick) -> None:
        """Fill the fields, once."""
        follower, due, every = Follower(), 0.0, max(_LOOK_S, self._length_s() / _LOOKS)
        for frame in self._frames():
            at = self.seconds(frame.pts)
            self.end_s = max(self.end_s, at)
            tick(min(1.0, self.end_s / max(self._length_s(), 1e-9)))
            if at >= due:
                due = at + 0.99 * every  # stamps are rounded
                luma = _luma(frame, self.stream.size)
                self.turns = round(-frame.rotation / 90) % 4
                self.looks.append(Look(frame.pts, sharpness(luma), follower.follow(luma)))

    def _frames(self) -> Iterator[Any]:
        """In display order. Behind damage, from the next key frame on: what refers to it is damaged too."""
        ends, healthy = time.monotonic() + DEADLINE_S, True
        for packet in self._packets():
            if time.monotonic() > ends:
                self.late = True
                return
            frames = decoded(packet)
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
        """Those to decode: of a long film the beginning of each group that a key frame leads, in decoding order, so
        that nothing refers to what is left out."""
        group_s, key, begun = self._group_s(), self.table.stamps[0], True
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
            if begun and since_s >= 0:  # what is shown before its key frame refers to the group before
                yield packet

    def _group_s(self) -> float:
        """Seconds from each key frame that are decoded."""
        cost = len(self.table.stamps) * math.prod(self.stream.size)
        keys = [*map(self.seconds, self.table.keys), self._length_s()]
        longest_s = float(np.diff(keys).max(initial=0))
        return longest_s * _BUDGET / cost if cost > _BUDGET and 0 < longest_s <= _LONGEST_GROUP_S else math.inf

    def _length_s(self) -> float:
        return self.seconds(self.table.stamps[-1])

    def faults(self, name: str) -> tuple[str, ...]:
        """A sentence about what could not be seen."""
        told_s = self.stream.told_s
        if self.late:
            seen = f"only the first {self.end_s:.0f} s of {self._length_s():.0f} s were looked at"
            return (f"{name}: {seen}; film for a minute at most",)
        if self.broken_s is not None:
            return (f"{name} is damaged at {self.broken_s:.1f} s; what can be decoded of it was used",)
        if self._length_s() < told_s - _TAIL_S:
            return (f"{name} breaks off at {self._length_s():.1f} s of {told_s:.1f} s; what comes before was used",)
        return ()


def view(path: Path, name: str, tick: Tick = no_tick) -> Viewing:
    """Raises CAPTURE_EMPTY, CAPTURE_UNREADABLE and IMAGE_TOO_LARGE."""
    table = read_table(open_video(path, name), name)
    if not table.stamps:
        raise CaptureError("CAPTURE_EMPTY", "holds no frames", file=name, hints=("film the thing again",))
    viewing = Viewing(open_video(path, name, SKIP), table)
    viewing.watch(tick)
    return viewing


def _luma(frame: Any, size: tuple[int, int]) -> Bytes:
    """(H,W) uint8 at the size that is judged, also of a frame of another size than the film's."""
    shrink = max(1.0, max(size) / LONGEST)
    width, height = (max(1, round(side / shrink)) for side in size)
    return np.asarray(frame.reformat(width, height, format="gray", interpolation="AREA").to_ndarray(), np.uint8)
