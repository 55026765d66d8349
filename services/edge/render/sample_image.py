"""Look up and shrink images, whose positions are in shares of their sides: an image's edges are at 0 and 1."""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats

_COLUMNS = 1 << 10  # cv2.remap takes at most 32,767 rows or columns


def bilinear(image: Bytes | Floats, at: Floats) -> Floats:
    """Sample an image (h,w,C) at positions (N,2), bilinearly: (N,C) float32. Outside of it the nearest edge counts."""
    import cv2

    return _sample(image, at, cv2.INTER_LINEAR)


def bicubic(image: Floats, at: Floats) -> Floats:
    """Sample as `bilinear`, but sharper; beside edges the result exceeds the image's range by up to a tenth."""
    import cv2

    return _sample(image, at, cv2.INTER_CUBIC)


def _sample(image: Bytes | Floats, at: Floats, method: int) -> Floats:
    import cv2

    height, width = image.shape[:2]
    rows = -(-len(at) // _COLUMNS)
    if not rows:
        return np.zeros((0, image.shape[2]), np.float32)
    grid = np.zeros((2, rows * _COLUMNS), np.float32)
    grid[:, : len(at)] = (at * [width, height] - 0.5).T
    column, row = grid.reshape(2, rows, _COLUMNS)
    sampled = cv2.remap(image, column, row, method, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(sampled.reshape(-1, image.shape[2])[: len(at)], np.float32)


def pixels_at(image: Floats | Bytes | Bools, at: Floats) -> Floats:
    """Look up the pixels (N,...) of an image (h,w,...) at positions (N,2); outside of it the nearest edge counts."""
    side = np.array(image.shape[1::-1])
    column, row = np.clip(at * side, 0, side - 1).astype(np.int64).T
    found: Floats = image[row, column]
    return found


def shrink_to(rgb: Bytes, longest: int) -> Bytes:
    """Downsample a picture (h,w,3) whose longer side is longer, by the mean of areas."""
    import cv2

    by = longest / max(rgb.shape[:2])
    if by >= 1:
        return rgb
    size = (max(1, round(rgb.shape[1] * by)), max(1, round(rgb.shape[0] * by)))
    return np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), np.uint8)


def resize_mask(mask: Bools, size: tuple[int, int]) -> Bools:
    """Resize a mask (h,w) to (width, height), without interpolation."""
    import cv2

    return np.asarray(cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0)
