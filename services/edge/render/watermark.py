"""Write a word across the foot of a picture: of what nobody measured, that it was not."""

from __future__ import annotations

import cv2
import numpy as np

from capture2vr.edge.arrays import Bytes

_FONT = cv2.FONT_HERSHEY_SIMPLEX
_WIDE, _HIGH = 0.6, 0.085  # of the picture's side: the word and, of twice its letters' height, the band around it
_PAPER, _INK = 32, 255  # sRGB levels


def watermark(picture: Bytes, word: str) -> Bytes:
    """Return a picture (S,S,3) or with alpha (S,S,4) with a word in its middle at the foot; "": the picture itself."""
    if not word:
        return picture
    side = len(picture)
    (width, height), _ = cv2.getTextSize(word, _FONT, 1.0, 2)
    scale = min(_WIDE * side / width, _HIGH / 2 * side / height)
    thick = max(1, round(2 * scale))
    (width, height), below = cv2.getTextSize(word, _FONT, scale, thick)
    left, foot = (side - width) // 2, side - below - height // 2
    marked = np.ascontiguousarray(picture)
    full = (255,) * (picture.shape[2] - 3)
    corner, other = (left - height, foot - 2 * height), (left + width + height, side)
    cv2.rectangle(marked, corner, other, (_PAPER, _PAPER, _PAPER, *full), cv2.FILLED)
    cv2.putText(marked, word, (left, foot - height // 3), _FONT, scale, (_INK, _INK, _INK, *full), thick, cv2.LINE_AA)
    return marked
