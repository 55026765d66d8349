"""Voxel grids as sorted integer keys: group points by voxel, and average observations frame by frame.

Memory is bounded, however many observations are added.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Bools, Floats, Ints

_BITS = 21
"""Bits per axis of a key: three axes fill 63 bits, so a grid spans two million voxels per side."""
_HALF = 1 << (_BITS - 1)
_MERGE_ROWS = 1_000_000
"""Buffered rows before they are merged into the grid: sorting few large batches is faster than sorting every frame."""
_COARSER = 1.26
"""Growth of the voxel size when the grid is full: 2^(1/3), about a third fewer voxels on a surface."""


def voxel_keys(xyz: Floats, voxel: float) -> Ints:
    """Return int64 keys (N,) of points (N,3), equal for points of one voxel.

    xyz is relative to an origin nearby: points beyond the grid's range get the keys of its border.
    """
    return cell_keys(np.clip(np.floor(xyz / voxel), -_HALF, _HALF - 1).astype(np.int64) + _HALF)


def cell_keys(cells: Ints) -> Ints:
    """Pack integer cells (N,3), each from 0 to 2^21 - 1, into keys (N,)."""
    keys: Ints = (cells[:, 0] << (2 * _BITS)) | (cells[:, 1] << _BITS) | cells[:, 2]
    return keys


def key_cells(keys: Ints) -> Ints:
    """Unpack keys (N,) into cells (N,3): the inverse of `cell_keys`."""
    mask = (1 << _BITS) - 1
    return np.stack([keys >> (2 * _BITS), (keys >> _BITS) & mask, keys & mask], axis=1)


def sum_groups(keys: Ints, values: Floats) -> tuple[Ints, Floats]:
    """Sum the rows of `values` (N,C) that share a key; return the distinct keys (M,), ascending, and the sums (M,C)."""
    from scipy.sparse import csr_array

    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    starts = np.flatnonzero(np.r_[True, keys[1:] != keys[:-1]]) if len(keys) else np.zeros(0, np.int64)
    # Sorting the rows and np.add.reduceat take three times as long as this sparse product.
    members = csr_array(
        (np.ones(len(keys), values.dtype), order, np.append(starts, len(keys))), shape=(len(starts), len(keys))
    )
    return keys[starts], members @ values


@dataclass(frozen=True, slots=True)
class Samples:
    """Observations of surface points, one row each; everything float32 but xyz.

    xyz (N,3) relative to the grid's origin; normal (N,3) unit, towards the viewer, or zeros;
    light (N,3) linear colour, zeros without a picture; confidence (N,) in [0,1]; weight (N,) of the observation in
    averages; clarity (N,): additional weight of its colour, 0 without a picture.
    """

    xyz: Floats
    normal: Floats
    light: Floats
    clarity: Floats
    confidence: Floats
    weight: Floats

    def __len__(self) -> int:
        return len(self.xyz)

    def take(self, index: Ints | Bools) -> Samples:
        """Return the rows of a mask or of indices."""
        return Samples(
            self.xyz[index],
            self.normal[index],
            self.light[index],
            self.clarity[index],
            self.confidence[index],
            self.weight[index],
        )


class GridFullError(Exception):
    """More voxels than a grid may have, which may not be any larger."""


class VoxelGrid:
    """Weighted averages of observations per voxel, for at most `limit` voxels: with more, the voxel size grows.

    coarsest  largest voxel size; where a larger one were needed, `add` and `averages` raise GridFullError
    Memory is that of the voxels plus `_MERGE_ROWS` buffered rows, however many observations are added.
    """

    def __init__(self, voxel: float, limit: int, coarsest: float = math.inf) -> None:
        self.voxel = voxel
        self._limit, self._coarsest = limit, coarsest
        self._keys: Ints = np.zeros(0, np.int64)
        self._sums: Floats = np.zeros((0, 12), np.float32)
        self._buffer: list[tuple[Ints, Floats]] = []

    def add(self, samples: Samples) -> None:
        """Add observations; they are buffered and merged in large batches."""
        self._buffer.append(sum_groups(voxel_keys(samples.xyz, self.voxel), _moments(samples)))
        if sum(len(keys) for keys, _ in self._buffer) > max(_MERGE_ROWS, len(self._keys) // 2):
            self._merge()

    def averages(self) -> Samples:
        """Return one averaged sample per voxel; its weight is the sum of the weights."""
        self._merge()
        return _average(self._sums)

    def _merge(self) -> None:
        """Merge the buffer into the grid, and enlarge the voxels while there are too many."""
        batches: list[tuple[Ints, Floats]] = [(self._keys, self._sums), *self._buffer]
        all_keys = np.concatenate([batch[0] for batch in batches])
        sums: Floats = np.concatenate([batch[1] for batch in batches])
        self._keys, self._sums = sum_groups(all_keys, sums)
        self._buffer.clear()
        while len(self._keys) > self._limit:
            if self.voxel * _COARSER > self._coarsest:
                raise GridFullError
            self.voxel *= _COARSER
            means = self._sums[:, 1:4] / self._sums[:, :1]
            self._keys, self._sums = sum_groups(voxel_keys(means, self.voxel), self._sums)


def _moments(samples: Samples) -> Floats:
    """Return the rows that are summed (N,12) float32: w, w·xyz, w·normal, w·confidence, w·clarity, w·clarity·light."""
    w = samples.weight.astype(np.float32)[:, None]
    lit = w * samples.clarity[:, None]
    columns: list[Floats] = [
        w,
        w * samples.xyz,
        w * samples.normal,
        w * samples.confidence[:, None],
        lit,
        lit * samples.light,
    ]
    return np.concatenate(columns, axis=1, dtype=np.float32)


def _average(sums: Floats) -> Samples:
    """Divide summed rows (N,12) by their weights."""
    w, lit = sums[:, :1], sums[:, 8:9]
    light = sums[:, 9:12] / np.where(lit > 0, lit, 1)
    return Samples(sums[:, 1:4] / w, sums[:, 4:7] / w, light, lit[:, 0] / w[:, 0], sums[:, 7] / w[:, 0], w[:, 0])
