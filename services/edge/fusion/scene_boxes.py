"""Cut a large scene into boxes whose voxels fit in memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Bools, Floats, Ints

CELL = 8
"""Side, in voxels, of the cells by which a scene is cut: boxes end between them, so that no voxel lies in two boxes."""
_VOXELS_PER_CELL = 320
"""Of an occupied cell, with a box's rim: a plane fills 64, and a phone's noise four times as many; 220 to 310 were
measured on a flat of 4 rooms. With fewer, every second box would be too full at the first try."""


@dataclass(frozen=True, slots=True)
class SceneBox:
    """A part of space: low and high (3,) in cells, perhaps infinite; cells (N,3): the occupied ones in it."""

    low: Floats
    high: Floats
    cells: Ints

    @classmethod
    def around(cls, places: Floats, voxel: float) -> SceneBox:
        """Create the box to split: all of space, with the cells that contain the points (N,3), in metres."""
        cells = np.unique(np.floor(places / (CELL * voxel)).astype(np.int32), axis=0)
        return cls(np.full(3, -np.inf), np.full(3, np.inf), cells)

    def split(self, most: int) -> Iterator[SceneBox]:
        """Cut the box, again and again, into boxes of about `most` voxels each."""
        if len(self.cells) * _VOXELS_PER_CELL <= most or self.is_smallest:
            yield self
            return
        for half in self.halves():
            yield from half.split(most)

    @property
    def is_smallest(self) -> bool:
        """Whether all occupied cells are one, which cannot be cut."""
        return bool((np.ptp(self.cells, axis=0) == 0).all())

    def halves(self) -> tuple[SceneBox, SceneBox]:
        """Cut the box across its longer side into two, each with about half of the occupied cells."""
        axis = int(np.argmax(np.ptp(self.cells, axis=0)))
        along = self.cells[:, axis]
        cut = max(int(np.median(along)), int(along.min()) + 1)
        high, low = self.high.copy(), self.low.copy()
        high[axis] = low[axis] = cut
        return SceneBox(self.low, high, self.cells[along < cut]), SceneBox(low, self.high, self.cells[along >= cut])

    def bounds_m(self, voxel: float) -> tuple[Floats, Floats]:
        """Least and greatest coordinates (3,) in metres, perhaps infinite."""
        return self.low * CELL * voxel, self.high * CELL * voxel

    def occupied_m(self, voxel: float) -> tuple[Floats, Floats]:
        """The same of the occupied cells."""
        side = CELL * voxel
        return self.cells.min(axis=0) * side, (self.cells.max(axis=0) + 1) * side


def within(xyz: Floats, low: Floats, high: Floats) -> Bools:
    """Mask (N,) of places between low and high (3,), as is each place of space in one box of several."""
    inside: Bools = np.ones(len(xyz), bool)
    for axis in range(3):  # one column after the other: numpy takes five times as long for `all` along rows
        inside &= (xyz[:, axis] >= low[axis]) & (xyz[:, axis] < high[axis])
    return inside
