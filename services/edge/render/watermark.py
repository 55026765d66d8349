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
    top, right = foot - height - pad, left + width + pad
    rgb = np.ascontiguousarray(picture[..., :3])
    cv2.rectangle(rgb, (left - pad, top), (right, side), (_PAPER,) * 3, cv2.FILLED)
    cv2.putText(rgb, word, (left, foot), _FONT, scale, (_INK,) * 3, thick, cv2.LINE_AA)
    marked = np.dstack([rgb, picture[..., 3:]])
    marked[top:, left - pad : right + 1, 3:] = 255
    return marked
