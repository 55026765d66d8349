"""Where a frame's depth and colour come from: image and array files, each checked cheaply before it is read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from services.edge.arrays import Bytes, Floats
from services.edge.capture.files import unreadable
from services.edge.capture.images import decode_depth, decode_grey, decode_rgb, image_size, read_bytes
from services.edge.capture.tables import npy_array

MAX_DEPTH_M = 1_000.0  # metres; no phone measures further, so more is a value for "unknown"


class DepthSource(Protocol):
    """`file` names it in errors; `size()` is (width, height) from the header; `load()` is (H,W)
    float32 metres, 0 unknown."""

    @property
    def file(self) -> str: ...

    def size(self) -> tuple[int, int]: ...

    def load(self) -> Floats: ...


class ColourSource(Protocol):
    """As `DepthSource`; `load()` is (h,w,3) uint8 sRGB with the depth image's field of view."""

    @property
    def file(self) -> str: ...

    def size(self) -> tuple[int, int]: ...

    def load(self) -> Bytes: ...


@dataclass(frozen=True, slots=True)
class ImageColour:
    """A picture in a file."""

    path: Path
    file: str

    def size(self) -> tuple[int, int]:
        return image_size(self.path, self.file)

    def load(self) -> Bytes:
        return decode_rgb(read_bytes(self.path, self.file), self.file)


@dataclass(frozen=True, slots=True)
class ImageDepth:
    """A one-channel PNG or TIFF; metres = value * metres_per_step."""

    path: Path
    file: str
    metres_per_step: float

    def size(self) -> tuple[int, int]:
        return image_size(self.path, self.file)

    def load(self) -> Floats:
        values = decode_depth(read_bytes(self.path, self.file), self.file)
        return known_depth(values * np.float32(self.metres_per_step))


@dataclass(frozen=True, slots=True)
class ArrayDepth:
    """A .npy of shape (H,W); metres = value * metres_per_step."""

    path: Path
    file: str
    metres_per_step: float

    def size(self) -> tuple[int, int]:
        shape = self._array().shape
        return shape[1], shape[0]

    def load(self) -> Floats:
        return known_depth(self._array().astype(np.float32) * np.float32(self.metres_per_step))

    def _array(self) -> Floats:
        array = np.squeeze(npy_array(self.path, self.file))
        if array.ndim != 2:
            raise unreadable(self.file, f"has shape {array.shape}; depth has height and width")
        return array


def depth_file(path: Path, file: str, metres_per_step: float) -> DepthSource:
    """Of a .npy or an image; whether it is one shows when its header is read."""
    kind = ArrayDepth if file.lower().endswith(".npy") else ImageDepth
    return kind(path, file, metres_per_step)


def known_depth(depth_m: Floats) -> Floats:
    """(H,W) float32 with 0 for what is NaN, infinite, negative or beyond MAX_DEPTH_M."""
    known = (depth_m > 0) & (depth_m < MAX_DEPTH_M)
    return np.where(known, depth_m, np.float32(0)).astype(np.float32, copy=False)


def confidence_image(path: Path, file: str) -> Floats:
    """(H,W) float32 in [0,1] from a one-channel image of ARKit's levels, stored as 0, 1, 2 or as 0, 127, 255."""
    values = decode_grey(read_bytes(path, file), file)
    highest = np.float32(2 if values.max(initial=0) <= 2 else 255)
    confidence: Floats = np.clip(values / highest, 0, 1)
    return confidence
