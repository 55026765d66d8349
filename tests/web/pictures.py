"""Looking at a screenshot: how much of it shows something, and where."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image


def drawn(png: bytes) -> float:
    """Share of the picture that differs from its upper left corner."""
    pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)
    return float((np.abs(pixels - pixels[0, 0]).max(axis=2) > 12).mean())


def difference(first: bytes, second: bytes) -> float:
    """Share of pixels that changed between two pictures of one size."""
    one, two = (np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int) for png in (first, second))
    return float((np.abs(one - two).max(axis=2) > 12).mean())
