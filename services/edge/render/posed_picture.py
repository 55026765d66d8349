"""A photo with its camera, in the frame of a mesh: what textures are baked from, and what a mesh is compared with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats, Ints

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class PosedPicture:
    """A photo with its camera; pixels are loaded on demand.

    to_camera      (4,4) the mesh's frame -> OpenCV axes of the camera, in the units of its depth image
    focal, middle  (2,) focal length and principal point, in shares of the photo's width and height; its edges are at 0
                   and 1
    load_rgb       -> (h,w,3) uint8 sRGB
    load_depth     -> (H,W) float32 of the same field of view, 0 where unknown; None where there is no depth image
    name           of the photo in the capture, for messages
    tracked        whether the pose is a device's tracking, which errs by pixels
    load_mask      -> (H,W) bool, where the object is, of the same field of view; None where no mask came with it
    """

    to_camera: Floats
    focal: Floats
    middle: Floats
    load_rgb: Callable[[], Bytes]
    load_depth: Callable[[], Floats] | None = None
    name: str = ""
    tracked: bool = False
    load_mask: Callable[[], Bools] | None = None

    @property
    def eye(self) -> Floats:
        """Position (3,) of the camera, in the mesh's frame."""
        eye: Floats = np.linalg.inv(self.to_camera)[:3, 3]
        return eye

    def loaded(self) -> PosedPicture:
        """Return the same picture with its pixels in memory: it can be pickled."""
        depth = None if self.load_depth is None else partial(_same, self.load_depth())
        mask = None if self.load_mask is None else partial(_same, self.load_mask())
        return replace(self, load_rgb=partial(_same, self.load_rgb()), load_depth=depth, load_mask=mask)

    def depth(self) -> Floats:
        """Load the depth image (H,W); one pixel of 0, unknown, where there is none."""
        return np.zeros((1, 1), np.float32) if self.load_depth is None else self.load_depth()

    def in_view(self, places: Floats) -> tuple[Ints, Floats, Floats]:
        """Find the places (N,3) in the picture: their indices (M,), positions (M,2) and depth (M,), as in `project`."""
        at, z = self.project(places)
        index = np.flatnonzero((z > 0) & (np.minimum(at, 1 - at).min(axis=1) > 0))
        return index, at[index], z[index]

    def project(self, places: Floats) -> tuple[Floats, Floats]:
        """Project places (N,3): positions (N,2) in shares of the photo's sides, and depth (N,), ≤ 0 behind the camera.

        Both are of the places' type. The positions of places behind the camera are meaningless.
        """
        # Column by column: numpy takes ten times as long for a product of (N,3) and (3,3).
        kind = places.dtype if places.dtype == np.float32 else np.dtype(np.float64)
        columns = np.ascontiguousarray(places.T, kind)
        x, y, z = (row[0] * columns[0] + row[1] * columns[1] + row[2] * columns[2] + row[3]
                   for row in self.to_camera[:3].astype(kind))  # fmt: skip
        over = 1 / np.maximum(z, kind.type(1e-9))
        at: Floats = np.empty((len(places), 2), kind)
        for axis, value in enumerate((x, y)):
            at[:, axis] = value * over * kind.type(self.focal[axis]) + kind.type(self.middle[axis])
        return at, z


def _same(value: T) -> T:
    return value
