"""Single frames out of a video, decoded when asked for and not before."""

from __future__ import annotations

import threading
from bisect import bisect_left
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from services.edge.arrays import Bytes
from services.edge.capture.files import reading
from services.edge.capture.images import broken_image
from services.edge.capture.streams import Skip, Stream, Table, decoded, open_video, read_table

_SMALL = 1600  # pixels of the longer side of frames held in memory: more than alignment and stereo ever ask for


@dataclass(frozen=True, slots=True)
class VideoColour:
    """Frame `index` of a video whose pictures have `shape` = (width, height)."""

    video: VideoFrames
    index: int
    shape: tuple[int, int]

    @property
    def file(self) -> str:
        return self.video.file

    def size(self) -> tuple[int, int]:
        return self.shape

    def load(self) -> Bytes:
        return self.video.rgb(self.index)


@dataclass(frozen=True, slots=True)
class VideoPixels:
    """The frame at `stamp` of a video whose pictures have `size` = (width, height): a `LoadPhoto`."""

    video: VideoFrames
    stamp: int
    size: tuple[int, int]

    def __call__(self, longest: int | None = None) -> Bytes:
        width, height = self.size
        shrink = max(1.0, max(self.size) / (longest or max(self.size)))
        return self.video.at(self.stamp, (max(1, round(width / shrink)), max(1, round(height / shrink))))


class VideoFrames:
    """Frames of a video by their number in display order, or by their stamp.

    Cheapest in rising order; going back, and far ahead, starts at the codec's key frame before the one asked for.
    `kept` are stamps that are asked for again and again: they stay in memory, at most _SMALL pixels wide, 2 MB each.
    `skip` as in `open_video`: only with stamps. Safe to use from several threads. Raises IMAGE_UNREADABLE for a frame
    that cannot be had. Pixels are as stored, not turned by the container's rotation: the intrinsics mean the sensor.
    """

    def __init__(self, path: Path, file: str, *, kept: Collection[int] = (), skip: Skip = "DEFAULT") -> None:
        self._path, self.file, self._skip = path, file, skip
        self._lock = threading.Lock()
        self._kept, self._small = frozenset(kept), dict[int, Any]()
        self._table: Table | None = None
        self._stream: Stream | None = None
        self._frames: Iterator[Any] = iter(())
        self._last: Any = None
        self._gone: set[int] = set()

    def size(self) -> tuple[int, int]:
        """(width, height) from the header, checked against the limit of pixels."""
        return open_video(self._path, self.file).size

    def rgb(self, index: int) -> Bytes:
        """(H,W,3) uint8 sRGB of frame `index`."""
        with self._lock, reading(self.file, "video"):
            stamps = self._read_table().stamps
            frame = self._frame(stamps[index]) if index < len(stamps) else None
            if frame is None:
                raise broken_image(self.file, f"ends before frame {index}")
            return np.ascontiguousarray(frame.to_ndarray(format="rgb24"))

    def at(self, stamp: int, size: tuple[int, int]) -> Bytes:
        """(H,W,3) uint8 sRGB of the frame with this stamp, scaled to `size` = (width, height)."""
        with self._lock, reading(self.file, "video"):
            frame = self._small.get(stamp)
            if frame is None or frame.width < size[0]:
                frame = self._frame(stamp)
            if frame is None:
                raise broken_image(self.file, "cannot be decoded there")
            scaled = frame.reformat(*size, format="rgb24", interpolation="AREA")
            return np.ascontiguousarray(scaled.to_ndarray())

    def _read_table(self) -> Table:
        if self._table is None:
            self._table = read_table(open_video(self._path, self.file), self.file)
        return self._table

    def _frame(self, stamp: int) -> Any:
        """None where it does not decode, or the file ends before it."""
        if stamp in self._gone:
            return None
        if self._last is not None and self._last.pts == stamp:
            return self._last
        key = self._read_table().key_before(stamp)
        if self._last is None or not key <= self._last.pts < stamp:
            self._start(key)
        frame = self._ahead(stamp)
        if frame is None:  # containers without an index lead elsewhere
            self._start(None)
            frame = self._ahead(stamp)
        if frame is None:
            self._note_gone(stamp)
        return frame

    def _note_gone(self, stamp: int) -> None:
        """What lies between a frame that did not come and the one that came instead: asking again would be as long."""
        stamps = self._read_table().stamps
        end = bisect_left(stamps, self._last.pts) if self._last is not None else len(stamps)
        self._gone.update(stamps[bisect_left(stamps, stamp) : end])

    def _start(self, key: int | None) -> None:
        """Decode from the key frame with this stamp, or from the beginning."""
        import av

        self._last = None
        if self._stream is None or key is None:
            self._stream = open_video(self._path, self.file, self._skip)
        if key is not None:
            try:
                self._stream.container.seek(key, stream=self._stream.film)
            except av.FFmpegError:
                self._stream = open_video(self._path, self.file, self._skip)
        packets = self._stream.packets()
        self._frames = (frame for packet in packets for frame in decoded(packet) or () if frame.pts is not None)

    def _ahead(self, stamp: int) -> Any:
        """Decode on to a frame."""
        for frame in self._frames:
            self._last = frame
            if frame.pts in self._kept and frame.pts not in self._small:
                self._small[frame.pts] = _small(frame)
            if frame.pts >= stamp:
                return frame if frame.pts == stamp else None
        self._last = None
        return None


def _small(frame: Any) -> Any:
    """The frame at no more than _SMALL pixels along its longer side, at 12 bits a pixel."""
    shrink = max(1.0, max(frame.width, frame.height) / _SMALL)
    width, height = (max(1, round(side / shrink)) for side in (frame.width, frame.height))
    return frame.reformat(width, height, format="yuv420p", interpolation="AREA")
