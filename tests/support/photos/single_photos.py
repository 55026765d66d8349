"""A photo of given pixels, without a file."""

from __future__ import annotations

import cv2
import numpy as np

from capture2vr.edge.arrays import Bytes
from capture2vr.edge.capture.nouns import Photo


def photo(rgb: Bytes, *, turns: int = 0, name: str = "one.jpg") -> Photo:
    """A photo whose stored picture is `rgb` (h,w,3)."""

    def load(longest: int | None = None) -> Bytes:
        by = min(1.0, (longest or max(rgb.shape)) / max(rgb.shape[:2]))
        return np.asarray(cv2.resize(rgb, None, fx=by, fy=by, interpolation=cv2.INTER_AREA), np.uint8)

    return Photo(name, rgb.shape[1::-1], "camera", load, turns=turns)
