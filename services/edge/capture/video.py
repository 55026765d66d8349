"""Single frames out of a recording's video, decoded when asked for and not before."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from services.edge.arrays import Bytes
from services.edge.capture.files import reading
from services.edge.capture.images import broken_image, check_pixels


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


class VideoFrames:
    """Frame `index` of a video, counted in display order; ask in rising order: going back decodes from the start.

    Safe to use from several threads. Raises IMAGE_UNREADABLE for a video that ends before the frame.
    """

    def __init__(self, path: Path, file: str) -> None:
        self._path, self.file = path, file
        self._lock = threading.Lock()
        self._frames: Any = None
        self._next = 0

    def size(self) -> tuple[int, int]:
        """(width, height) from the header, checked against the limit of pixels."""
        import av

        with reading(self.file, "video"), av.open(str(self._path)) as container:
            stream = container.streams.video[0]
            return check_pixels((stream.width, stream.height), self.file)

    def rgb(self, index: int) -> Bytes:
        """(H,W,3) uint8 sRGB as stored, not turned by the container's rotation: the intrinsics mean the sensor."""
        with self._lock, reading(self.file, "video"):
            if self._frames is None or index < self._next:
                self._frames, self._next = self._start(), 0
            for frame in self._frames:
                self._next += 1
                if self._next > index:
                    return np.ascontiguousarray(frame.to_ndarray(format="rgb24"))
            self._frames = None
        raise broken_image(self.file, f"ends before frame {index}")

    def _start(self) -> Any:
        import av

        container = av.open(str(self._path))
        container.streams.video[0].thread_type = "AUTO"
        return container.decode(video=0)
