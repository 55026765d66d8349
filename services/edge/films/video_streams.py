"""Detect and open video files, and index their frames with PyAV; FFmpeg's errors become CaptureError.

A frame's stamp is its presentation time in units of the stream's time base. It identifies a frame even with variable
frame rates, B-frames and edit lists, where a frame's number does not.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, Literal

from capture2vr.edge.capture.files import translate_errors, unreadable
from capture2vr.edge.capture.images import check_pixels
from capture2vr.edge.errors import CaptureError
from capture2vr.sentences.sentence import say

MAX_PIXELS = 8192 * 4320  # of a frame: the largest that phones record; a decoder keeps up to 16 in memory
MAX_FRAMES = 60_000  # of a video: half an hour at 30 frames per second; a walk around an object takes one minute
_BOXES = (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip")  # types of the first box of ISO media and QuickTime
_MATROSKA = b"\x1aE\xdf\xa3"
_RECTILINEAR = 4  # of FFmpeg's AVSphericalProjection: the picture of an ordinary lens
_SEND_AGAIN = say("copy_from_phone_again_export")


def container_of(head: bytes) -> str | None:
    """Return FFmpeg's name for a file's container by its first bytes, or None if it is not a supported video.

    FFmpeg gets this name, since its own detection can take a text file for a playlist and open the files in it.
    """
    if head[4:8] in _BOXES:
        return "mov"
    return "matroska" if head.startswith(_MATROSKA) else None


Skip = Literal["DEFAULT", "NONREF"]
"""FFmpeg's setting for frames that the decoder skips: DEFAULT none, NONREF those that no other frame refers to."""


@dataclass(frozen=True, slots=True)
class VideoStream:
    """An open container and its video stream `film`, of `size` = (width, height)."""

    container: Any
    film: Any
    size: tuple[int, int]

    @property
    def duration_s(self) -> float:
        """Duration in seconds from the header; 0 where it is missing."""
        if self.film.duration:
            return float(self.film.duration * self.film.time_base)
        return float(self.container.duration or 0) * 1e-6

    def packets(self) -> Iterator[Any]:
        """Iterate over the packets in decoding order, as far as the file is readable.

        Packets that an edit list hides are included, since others may refer to them; the decoder does not output them.
        """
        import av

        try:
            yield from self.container.demux(self.film)
        except av.FFmpegError:
            return  # the stamps of the packets until here show that the file is cut off


def open_video(path: Path, file: str, skip: Skip = "DEFAULT") -> VideoStream:
    """Open a video file. Raises CAPTURE_UNREADABLE, and IMAGE_TOO_LARGE above MAX_PIXELS.

    Later frames that are larger than the header says, and than MAX_PIXELS, are not decoded.
    """
    import av

    with translate_errors(file, "video"):
        with path.open("rb") as stream:
            kind = container_of(stream.read(8))
        if kind is None:
            raise unreadable(file, say("not_mp4_mov_webm_video"), _SEND_AGAIN)
        try:
            container = av.open(str(path), format=kind)
        except av.FFmpegError:  # its text has the server's own path
            raise unreadable(file, say("video_cut_off_never_finished"), _SEND_AGAIN) from None
        films = [film for film in container.streams.video if not film.disposition & av.stream.Disposition.attached_pic]
        if not films or films[0].codec_context is None:
            raise unreadable(file, say("has_no_video_track"), _SEND_AGAIN)
        codec = films[0].codec_context
        codec.options = {"max_pixels": str(MAX_PIXELS)}
        codec.thread_type, codec.skip_frame = "AUTO", skip
        return VideoStream(container, films[0], check_pixels((codec.width, codec.height), file, MAX_PIXELS))


def decode_packet(packet: Any) -> list[Any] | None:
    """Decode a packet; return the frames that it completes, or None if it or one of them is damaged.

    Several threads decode, so a damaged packet's frame may come with a later packet; the codec guesses what it lacks.
    """
    import av

    try:
        frames: list[Any] = packet.decode()
    except (av.FFmpegError, MemoryError):
        return None
    return None if packet.is_corrupt or any(frame.is_corrupt for frame in frames) else frames


Sphere = Literal["equirectangular", "other"]
"""How a frame shows all sides. other: as a cube, by a fisheye, of half of the sides, or twice, once for each eye."""


def sphere_of(frame: Any) -> Sphere | None:
    """Return how a frame shows all sides by the container's boxes `sv3d` and `st3d`, or Google's XML; None of others.

    FFmpeg hands its structs `AVSphericalMapping` and `AVStereo3D` on with each frame: their first number is the kind.
    """
    kinds = {each.type.name: int.from_bytes(bytes(each)[:4], "little") for each in frame.side_data}
    kind = kinds.get("SPHERICAL", _RECTILINEAR)
    if kind == _RECTILINEAR:
        return None
    return "equirectangular" if kind == 0 and not kinds.get("STEREO3D") else "other"


@dataclass(frozen=True, slots=True)
class FrameIndex:
    """Sorted stamps of all frames of a video, and of the codec's key frames among them."""

    stamps: tuple[int, ...]
    keys: tuple[int, ...]

    def key_before(self, stamp: int) -> int:
        """Return the last key frame at or before `stamp`, where decoding has to start; else the first frame."""
        at = bisect_right(self.keys, stamp)
        return self.keys[at - 1] if at else min(self.stamps[:1], default=stamp)


def read_index(stream: VideoStream, file: str) -> FrameIndex:
    """Read the stamps of all frames without decoding them. Raises CAPTURE_TOO_LARGE above MAX_FRAMES."""
    packets = (packet for packet in stream.packets() if packet.size and packet.pts is not None)
    found = [(packet.pts, packet.is_keyframe, packet.is_discard) for packet in islice(packets, MAX_FRAMES + 1)]
    if len(found) > MAX_FRAMES:
        hint = (say("film_minute"),)
        raise CaptureError("CAPTURE_TOO_LARGE", say("has_more_than_frames", most=MAX_FRAMES), file=file, hints=hint)
    shown = sorted((stamp, key) for stamp, key, left_out in found if not left_out)
    return FrameIndex(tuple(stamp for stamp, _ in shown), tuple(stamp for stamp, key in shown if key))
