"""Write a word across the foot of a picture: of what nobody measured, that it was not."""

from __future__ import annotations

import cv2
import numpy as np

from capture2vr.edge.arrays import Bytes

_FONT = cv2.FONT_HERSHEY_SIMPLEX
_WIDE, _HIGH = 0.6, 0.06  # most of the picture's side that the word takes, and its capitals
_PAPER, _INK = 32, 255  # sRGB levels


def watermark(picture: Bytes, word: str) -> Bytes:
    """Return a picture (S,S,3) or with alpha (S,S,4) with a word in its middle at the foot; "": the picture itself."""
    if not word:
        return picture
    side = len(picture)
    (width, height), _ = cv2.getTextSize(word, _FONT, 1.0, 2)
    scale = min(_WIDE * side / width, _HIGH * side / height)
    thick = max(1, round(2 * scale))
    (width, height), below = cv2.getTextSize(word, _FONT, scale, thick)
    pad = height // 2
    left, foot = (side - width) // 2, side - below - pad // 2
    marked = np.ascontiguousarray(picture)
    full = (255,) * (picture.shape[2] - 3)
    paper, ink = ((level,) * 3 + full for level in (_PAPER, _INK))
    cv2.rectangle(marked, (left - pad, foot - height - pad), (left + width + pad, side), paper, cv2.FILLED)
    cv2.putText(marked, word, (left, foot), _FONT, scale, ink, thick, cv2.LINE_AA)
    return marked
