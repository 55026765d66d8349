"""Plane sweep on the CPU: the `SweepBackend` in OpenCV and NumPy."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from capture2vr.edge.arrays import Bytes, Floats, Tick
from capture2vr.edge.photos.sgm import Costs, aggregate
from capture2vr.edge.photos.undistorted import UndistortedPhoto
from capture2vr.edge.photos.warp import Rays, WarpSource
from capture2vr.edge.photos.zncc import BestTwo, Windows


class CpuSweep:
    """`SweepBackend` on the CPU. Memory: 4 bytes per pixel and plane."""

    def __init__(self, reference: UndistortedPhoto, sources: Sequence[UndistortedPhoto]) -> None:
        self._windows = Windows.of(reference.grey)
        rays = Rays.of(reference)
        self._others = [WarpSource.of(reference, source) for source in sources]
        self._turned = [other.turned(rays) for other in self._others]

    def choose_planes(self, planes: Floats, tick: Tick) -> Floats:
        """Choose a plane for each pixel by SGM: its index (H,W), with a fraction between planes."""
        grey = self._windows.grey
        by_plane = np.empty((len(planes), grey.size), np.uint8)
        for number, q in enumerate(planes):
            by_plane[number] = self._cost(q).ravel()
            tick((number + 1) / len(planes))
        cost = np.asarray(cv2.transpose(by_plane), np.uint8).reshape(*grey.shape, len(planes))
        return _lowest(aggregate(cost, grey.astype(np.uint8)))

    def score(self, q: Floats) -> Floats:
        """Return the ZNCC (H,W) in [-1,1] at the inverse depths q (H,W): the mean of the two best sources."""
        best = BestTwo(q.shape)
        for other, turned in zip(self._others, self._turned, strict=True):
            best.add(self._windows.zncc(other.at(turned, q)))
        return best.mean()

    def _cost(self, q: float) -> Bytes:
        """Return the matching cost (H,W) uint8 on the plane at inverse depth q: 0 for ZNCC 1, 255 for -1."""
        shape = self._windows.grey.shape
        best = BestTwo(shape)
        for other in self._others:
            best.add(self._windows.zncc(other.on_plane(q, shape)))
        return np.asarray(cv2.convertScaleAbs(best.mean(), alpha=-127.5, beta=127.5))


def _lowest(total: Costs) -> Floats:
    """Return the index (H,W) of the plane of least cost, with a fraction from a parabola through its neighbours."""
    count = total.shape[2]
    index = np.clip(total.argmin(axis=2), 1, count - 2)[..., None]
    before, here, after = (
        np.take_along_axis(total, index + step, axis=2)[..., 0].astype(np.float32) for step in (-1, 0, 1)
    )
    plane: Floats = index[..., 0] + vertex(before, here, after)
    return plane


def vertex(before: Floats, here: Floats, after: Floats) -> Floats:
    """Return the minimum of the parabola through three values one step apart, in steps from the middle: -1 to 1."""
    bend = before - 2 * here + after
    offset = np.where(bend > 0, 0.5 * (before - after) / np.where(bend > 0, bend, 1), np.sign(before - after))
    return np.clip(offset, -1, 1).astype(np.float32)
