"""Video files: which they are, opened and taken apart, with FFmpeg's errors told as ours.

A frame's stamp is its presentation time in units of the stream's time base: the one name that a frame has under
variable frame rates, frames that refer forward, and edit lists.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, Literal

from services.edge.capture.files import reading, unreadable
from services.edge.capture.images import check_pixels
from services.edge.errors import CaptureError

MAX_PIXELS = 8192 * 4320  # of a frame: the largest that phones film; a decoder holds up to 16 of them
MAX_FRAMES = 60_000  # half an hour of 30 frames a second; a walk around a thing takes one minute
_BOXES = (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip")  # that ISO media and QuickTime files begin with
_MATROSKA = b"\x1aE\xdf\xa3"
_SEND_AGAIN = "copy it from the phone again, or export it as mp4"


def container_of(head: bytes) -> str | None:
    """FFmpeg's name for the container that a file of these first bytes is, None for what is read as no video.

    Named, since FFmpeg's own guess takes a text file for a playlist and opens what that names.
    """
    if head[4:8] in _BOXES:
        return "mov"
    return "matroska" if head.startswith(_MATROSKA) else None


Skip = Literal["DEFAULT", "NONREF"]
"""Frames that the decoder leaves out, in FFmpeg's words: none, or those that no other frame refers to."""


@dataclass(frozen=True, slots=True)
class Stream:
    """An open container and the stream in it that is the film, of `size` = (width, height)."""

    container: Any
    film: Any
    size: tuple[int, int]

    @property
    def told_s(self) -> float:
        """The film's length by its header, in seconds; 0 where that says nothing."""
        if self.film.duration:
            return float(self.film.duration * self.film.time_base)
        return float(self.container.duration or 0) * 1e-6

    def packets(self) -> Iterator[Any]:
        """In the order of decoding, as far as the file goes. Those that an edit list leaves out are fed, not shown."""
        import av

        try:
            yield from self.container.demux(self.film)
        except av.FFmpegError:
            return  # what was cut off is told by the times of what came


def open_video(path: Path, file: str, skip: Skip = "DEFAULT") -> Stream:
    """Raises CAPTURE_UNREADABLE and IMAGE_TOO_LARGE. What is larger further on than in its header is not decoded."""
    import av

    with reading(file, "video"):
        with path.open("rb") as stream:
            kind = container_of(stream.read(8))
        if kind is None:
            raise unreadable(file, "is no mp4, mov or webm video", _SEND_AGAIN)
        try:
            container = av.open(str(path), format=kind)
        except av.FFmpegError:  # would tell our own path
            raise unreadable(file, "is a video that was cut off or never finished", _SEND_AGAIN) from None
        films = [film for film in container.streams.video if not film.disposition & av.stream.Disposition.attached_pic]
        if not films or films[0].codec_context is None:
            raise unreadable(file, "holds no film that can be read", _SEND_AGAIN)
        codec = films[0].codec_context
        codec.options = {"max_pixels": str(MAX_PIXELS)}
        codec.thread_type, codec.skip_frame = "AUTO", skip
        return Stream(container, films[0], check_pixels((codec.width, codec.height), file, MAX_PIXELS))


def decoded(packet: Any) -> list[Any] | None:
    """The frames that a packet completes, None where it is damaged."""
    import av

    try:
        frames: list[Any] = packet.decode()
    except (av.FFmpegError, MemoryError):
        return None
    return None if packet.is_corrupt else frames


@dataclass(frozen=True, slots=True)
class Table:
    """Stamps of all frames and of the codec's key frames among them, rising."""

    stamps: tuple[int, ...]
    keys: tuple[int, ...]

    def key_before(self, stamp: int) -> int:
        """The last key frame from which the frame at `stamp` can be decoded; the first frame where there is none."""
        at = bisect_right(self.keys, stamp)
        return self.keys[at - 1] if at else min(self.stamps[:1], default=stamp)


def read_table(stream: Stream, file: str) -> Table:
    """Raises CAPTURE_TOO_LARGE."""
    packets = (packet for packet in stream.packets() if packet.size and packet.pts is not None)
    found = [(packet.pts, packet.is_keyframe, packet.is_discard) for packet in islice(packets, MAX_FRAMES + 1)]
    if len(found) > MAX_FRAMES:
        hint = ("film for a minute at most",)
        raise CaptureError("CAPTURE_TOO_LARGE", f"holds more than {MAX_FRAMES:,} frames", file=file, hints=hint)
    shown = sorted((stamp, key) for stamp, key, left_out in found if not left_out)
    return Table(tuple(stamp for stamp, _ in shown), tuple(stamp for stamp, key in shown if key))
