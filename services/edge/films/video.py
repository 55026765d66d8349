"""Decode single frames of a video on demand, with a cache of small copies."""

from __future__ import annotations

import threading
from bisect import bisect_left
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from capture2vr.edge.arrays import Bytes
from capture2vr.edge.capture.files import translate_errors
from capture2vr.edge.capture.images import broken_image
from capture2vr.edge.films.tone_map import is_hdr, srgb_of
from capture2vr.edge.films.video_streams import FrameIndex, Skip, VideoStream, decode_packet, open_video, read_index
from capture2vr.sentences.sentence import say

CACHED_PX = 1600  # longer side of the frames in the cache: more than alignment and stereo ever need


@dataclass(frozen=True, slots=True)
class VideoColour:
    """Frame number `index` of a video, as a lazy colour image of `shape` = (width, height)."""

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
    """Decodes the frame at `stamp` of a video with frames of `size` = (width, height): a `LoadPhoto`."""

    video: VideoFrames
    stamp: int
    size: tuple[int, int]

    def __call__(self, longest: int | None = None) -> Bytes:
        width, height = self.size
        shrink = max(1.0, max(self.size) / (longest or max(self.size)))
        return self.video.at(self.stamp, (max(1, round(width / shrink)), max(1, round(height / shrink))))


class VideoFrames:
    """Random access to the frames of a video, by their number in display order or by their stamp. Thread-safe.

    Access is cheapest in ascending order; going back, or far ahead, seeks to the codec's key frame before the frame.
    `cached` are stamps of frames that will be read repeatedly: copies of at most `cached_px` pixels, 2 MB each of
    1600, are cached. `skip` as in `open_video`; use it only with stamps. Reading a frame that cannot be decoded raises
    IMAGE_UNREADABLE. Pixels are as stored, without the container's rotation: the intrinsics are the sensor's.
    """

    def __init__(
        self,
        path: Path,
        file: str,
        *,
        cached: Collection[int] = (),
        skip: Skip = "DEFAULT",
        cached_px: int = CACHED_PX,
    ) -> None:
        self._path, self.file, self._skip, self._cached_px = path, file, skip, cached_px
        self._lock = threading.Lock()
        self._cached_stamps, self._cache = frozenset(cached), dict[int, Any]()
        self._index: FrameIndex | None = None
        self._stream: VideoStream | None = None
        self._frames: Iterator[Any] = iter(())
        self._last: Any = None
        self._undecodable: set[int] = set()

    def size(self) -> tuple[int, int]:
        """Return (width, height) from the header. Raises IMAGE_TOO_LARGE."""
        return open_video(self._path, self.file).size

    def rgb(self, index: int) -> Bytes:
        """Decode frame number `index` to (H,W,3) uint8 sRGB."""
        with self._lock, translate_errors(self.file, "video"):
            stamps = self._read_index().stamps
            frame = self._frame(stamps[index]) if index < len(stamps) else None
            if frame is None:
                raise broken_image(self.file, say("ends_before_frame", index=index))
            return srgb_of(frame)

    def at(self, stamp: int, size: tuple[int, int]) -> Bytes:
        """Decode the frame with this stamp to (H,W,3) uint8 sRGB, scaled to `size` = (width, height)."""
        with self._lock, translate_errors(self.file, "video"):
            frame = self._cache.get(stamp)
            if frame is None or frame.width < size[0]:
                frame = self._frame(stamp)
            if frame is None:
                raise broken_image(self.file, say("has_frame_cannot_be_decoded"))
            return srgb_of(frame, size)

    def _read_index(self) -> FrameIndex:
        if self._index is None:
            self._index = read_index(open_video(self._path, self.file), self.file)
        return self._index

    def _frame(self, stamp: int) -> Any:
        """Return the decoded frame with this stamp; None if it cannot be decoded or the file ends before it."""
        if stamp in self._undecodable:
            return None
        if self._last is not None and self._last.pts == stamp:
            return self._last
        key = self._read_index().key_before(stamp)
        if self._last is None or not key <= self._last.pts < stamp:
            self._seek(key)
        frame = self._decode_until(stamp)
        if frame is None:  # in containers without an index, a seek may end elsewhere
            self._seek(None)
            frame = self._decode_until(stamp)
        if frame is None:
            self._note_undecodable(stamp)
        return frame

    def _note_undecodable(self, stamp: int) -> None:
        """Mark the frames from `stamp` to the one that came instead as undecodable: they are not searched again."""
        stamps = self._read_index().stamps
        end = bisect_left(stamps, self._last.pts) if self._last is not None else len(stamps)
        self._undecodable.update(stamps[bisect_left(stamps, stamp) : end])

    def _seek(self, key: int | None) -> None:
        """Seek to the key frame with this stamp, or to the beginning for None."""
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
        self._frames = (frame for packet in packets for frame in decode_packet(packet) or () if frame.pts is not None)

    def _decode_until(self, stamp: int) -> Any:
        """Decode frames until the one with this stamp; None if it does not come."""
        for frame in self._frames:
            self._last = frame
            if frame.pts in self._cached_stamps and frame.pts not in self._cache:
                self._cache[frame.pts] = _small(frame, self._cached_px)
            if frame.pts >= stamp:
                return frame if frame.pts == stamp else None
        self._last = None
        return None


def _small(frame: Any, most: int) -> Any:
    """Return a copy of a frame for the cache: at most `most` pixels along the longer side, 12 bits per pixel, 24 where
    it is of high dynamic range."""
    shrink = max(1.0, max(frame.width, frame.height) / most)
    width, height = (max(1, round(side / shrink)) for side in (frame.width, frame.height))
    form = "yuv420p10le" if is_hdr(frame) else "yuv420p"
    return frame.reformat(width, height, format=form, interpolation="AREA")
