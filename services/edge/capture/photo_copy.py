"""Keep a smaller copy of a photo: a job decodes it ten times, and 12 megapixels of HEIC take 0.6 s each time."""

from __future__ import annotations

import threading

import numpy as np

from capture2vr.edge.arrays import Bytes
from capture2vr.edge.capture.nouns import LoadPhoto
from capture2vr.edge.capture.picture import PhotoPixels

COPY_PX = 1920
"""Longer side of the copies: no step but a single photo's reads more."""
_QUALITY = 95
"""Of the copies, which are JPEG, about a megabyte each: 1 grey level is lost."""


def keep_copy(pixels: PhotoPixels) -> LoadPhoto:
    """Return a loader of the same photo that decodes it once; `pixels` itself where its file is as good as a copy."""
    return pixels if pixels.decoder != "heif" and max(pixels.size) <= COPY_PX else PhotoCopy(pixels)


class PhotoCopy:
    """Decodes a photo from a copy in memory, which the first call makes: a `LoadPhoto`. Thread-safe.

    More pixels than the copy has are decoded from the photo itself. Calling it raises IMAGE_UNREADABLE.
    """

    def __init__(self, whole: LoadPhoto) -> None:
        self._whole = whole
        self._lock = threading.Lock()
        self._copy: PhotoPixels | None = None

    def __call__(self, longest: int | None = None) -> Bytes:
        if longest is None or longest > COPY_PX:
            return self._whole(longest)
        with self._lock:
            if self._copy is None:
                self._copy = _copy_of(self._whole(COPY_PX))
        return self._copy(longest)


def _copy_of(rgb: Bytes) -> PhotoPixels:
    data = encode_copy(rgb)
    return PhotoPixels(lambda: data, "a copy", "opencv", (rgb.shape[1], rgb.shape[0]), 0)


def encode_copy(rgb: Bytes) -> bytes:
    """Encode a picture (h,w,3) as JPEG, with colours at full resolution."""
    import cv2

    settings = [cv2.IMWRITE_JPEG_QUALITY, _QUALITY]
    settings += [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
    _, data = cv2.imencode(".jpg", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), settings)
    return np.ascontiguousarray(data).tobytes()
