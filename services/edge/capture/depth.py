"""Sources of a frame's depth and colours: image and array files whose size is read from the header before decoding."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.capture.files import unreadable
from capture2vr.edge.capture.images import decode_depth, decode_grey, decode_rgb, image_size, read_bytes
from capture2vr.edge.capture.npy_array import npy_array
from capture2vr.sentences.sentence import say

_SATURATED = 65_535  # the largest value of 16 bits: beyond the sensor's range, or a marker for "unknown"
MAX_DEPTH_M = 1_000.0  # metres; no phone measures further, so a larger value is a marker for "unknown"


class DepthSource(Protocol):
    """Depth image that loads lazily. `file` is its name for errors; `size()` returns (width, height) from the header;
    `load()` returns (H,W) float32 metres, 0 where unknown."""

    @property
    def file(self) -> str: ...

    def size(self) -> tuple[int, int]: ...

    def load(self) -> Floats: ...


class ColourSource(Protocol):
    """Colour image of a frame, as `DepthSource`; `load()` returns (h,w,3) uint8 sRGB with the depth's field of view."""

    @property
    def file(self) -> str: ...

    def size(self) -> tuple[int, int]: ...

    def load(self) -> Bytes: ...


@dataclass(frozen=True, slots=True)
class ImageColour:
    """Colour image in a PNG, JPEG or TIFF file."""

    path: Path
    file: str

    def size(self) -> tuple[int, int]:
        return image_size(self.path, self.file)

    def load(self) -> Bytes:
        return decode_rgb(read_bytes(self.path, self.file), self.file)


@dataclass(frozen=True, slots=True)
class ImageDepth:
    """Depth image in a one-channel PNG or TIFF; metres = value * metres_per_step, and unknown for 65535."""

    path: Path
    file: str
    metres_per_step: float

    def size(self) -> tuple[int, int]:
        return image_size(self.path, self.file)

    def load(self) -> Floats:
        values = decode_depth(read_bytes(self.path, self.file), self.file)
        return zero_invalid_depth(np.where(values < _SATURATED, values, 0) * np.float32(self.metres_per_step))


@dataclass(frozen=True, slots=True)
class ArrayDepth:
    """Depth image in a .npy of shape (H,W); metres = value * metres_per_step."""

    path: Path
    file: str
    metres_per_step: float

    def size(self) -> tuple[int, int]:
        shape = self._array().shape
        return shape[1], shape[0]

    def load(self) -> Floats:
        return zero_invalid_depth(self._array().astype(np.float32) * np.float32(self.metres_per_step))

    def _array(self) -> Floats:
        array = np.squeeze(npy_array(self.path, self.file))
        if array.ndim != 2:
            raise unreadable(self.file, say("has_array_shape_depth_image", shape=array.shape))
        return array


def depth_file(path: Path, file: str, metres_per_step: float) -> DepthSource:
    """Return the depth source for a .npy or an image, chosen by the suffix; `size()` raises if the content differs."""
    kind = ArrayDepth if file.lower().endswith(".npy") else ImageDepth
    return kind(path, file, metres_per_step)


def zero_invalid_depth(depth_m: Floats) -> Floats:
    """Return depth as float32 with 0 (unknown) where it is NaN, infinite, negative or beyond MAX_DEPTH_M."""
    known = (depth_m > 0) & (depth_m < MAX_DEPTH_M)
    return np.where(known, depth_m, np.float32(0)).astype(np.float32, copy=False)


def confidence_image(path: Path, file: str) -> Floats:
    """Read a one-channel image of ARKit's confidence levels, stored as 0, 1, 2 or 0, 127, 255, to (H,W) in [0,1]."""
    values = decode_grey(read_bytes(path, file), file)
    highest = np.float32(2 if values.max(initial=0) <= 2 else 255)
    confidence: Floats = np.clip(values / highest, 0, 1)
    return confidence
