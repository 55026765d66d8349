"""What the models' classes have in common: pictures made tensors, and masks that are looked at before they count."""

from __future__ import annotations

import cv2
import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.models.graph import failed
from capture2vr.sentences.sentence import say

_ROUNDED = 1e-3  # how far the last sigmoid may miss [0,1] by rounding


def planes(picture: Floats) -> Floats:
    """Picture (h,w,3) -> (1,3,h,w) float32."""
    return np.ascontiguousarray(picture.transpose(2, 0, 1)[None], np.float32)


def resize(picture: Floats, size: tuple[int, ...]) -> Floats:
    """Resize to (width, height): averages where it gets smaller, interpolates where larger."""
    smaller = picture.shape[0] * picture.shape[1] > size[0] * size[1]
    way = cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(picture, (size[0], size[1]), interpolation=way), np.float32)


def check_mask(mask: Floats, model: str) -> None:
    """Check that a mask is in [0,1]. Raises ModelError MODEL_FAILED."""
    low, high = float(mask.min()), float(mask.max())
    if low < -_ROUNDED or high > 1 + _ROUNDED:
        raise failed(say("model_gave_no_mask", model=model, low=low, high=high))
