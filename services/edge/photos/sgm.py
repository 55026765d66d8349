"""Semi-global matching (SGM): smooth matching costs along four paths, so that neighbouring pixels get similar depths.

H. Hirschmüller, "Stereo Processing by Semiglobal Matching and Mutual Information", 2008, eq. 13. Along a path r

    L(p, d) = C(p, d) + min(L(p−r, d), L(p−r, d±1) + P1, min_k L(p−r, k) + P2) − min_k L(p−r, k)

and the d of the least sum of L over the paths is chosen for each pixel.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from capture2vr.edge.arrays import Bytes

Costs = NDArray[np.int16]

P1 = 16
"""Penalty for a step of one plane (the worst match costs 255): low, as slanted surfaces have many such steps."""
P2 = 120
"""Penalty for a larger jump where the picture is smooth; reduced at its edges, since depth jumps there."""
EDGE = 12.0
"""Difference of grey levels (0–255) between neighbours that halves P2."""


def aggregate(cost: Bytes, grey: Bytes) -> Costs:
    """Sum the costs (H,W,D) uint8 along four paths: (H,W,D) int16. grey: the reference picture (H,W) uint8."""
    total = np.zeros(cost.shape, np.int16)
    tone = grey.astype(np.int16)
    _paths(cost, total, _jump_penalty(np.abs(np.diff(tone, axis=0))))
    # Paths along the rows: the same on the transposed volume, copied to be contiguous for the cache.
    sideways = np.zeros((cost.shape[1], cost.shape[0], cost.shape[2]), np.int16)
    _paths(np.ascontiguousarray(cost.transpose(1, 0, 2)), sideways, _jump_penalty(np.abs(np.diff(tone, axis=1)).T))
    total += sideways.transpose(1, 0, 2)
    return total


def _jump_penalty(step: NDArray[np.int16]) -> NDArray[np.int16]:
    """Return the penalty (n-1,m) of a depth jump between neighbours whose grey levels differ by `step`."""
    penalty: NDArray[np.int16] = np.maximum(P2 / (1 + step / EDGE), P1 + 1).astype(np.int16)
    return penalty


def _paths(cost: Bytes, total: Costs, jump: NDArray[np.int16]) -> None:
    """Add the path costs of both directions along the first axis of `cost` (n,m,D); jump (n-1,m): rows i to i+1."""
    rows = len(cost)
    _path(cost, total, jump, range(rows))
    _path(cost, total, jump, range(rows - 1, -1, -1))


def _path(cost: Bytes, total: Costs, jump: NDArray[np.int16], rows: range) -> None:
    """Add the path costs of one direction, in the order of `rows`."""
    shape = cost.shape[1:]
    # Padding the depth axis with expensive planes avoids special cases for the first and the last plane.
    before = np.full((shape[0], shape[1] + 2), np.iinfo(np.int16).max // 2, np.int16)
    inner = before[:, 1:-1]
    here, side = np.empty(shape, np.int16), np.empty(shape, np.int16)
    inner[:] = 0
    least = np.zeros((shape[0], 1), np.int16)
    last = rows[0]
    for row in rows:
        np.minimum(before[:, :-2], before[:, 2:], out=side)
        side += P1
        np.minimum(side, inner, out=here)
        np.minimum(here, least + jump[min(row, last)][:, None] if row != last else least, out=here)
        here -= least
        here += cost[row]
        inner[:] = here
        least = here.min(axis=1, keepdims=True)
        total[row] += here
        last = row
