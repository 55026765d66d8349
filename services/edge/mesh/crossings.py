"""Find the grid edges that the surface crosses, and where it crosses them.

The gradients of an edge can be wrong, but the surface cannot end inside a cell. Around every grid face the number of
crossed edges must therefore be even, except at the open border. An edge that makes three or four of its four faces odd
is outvoted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Bools, Floats, Ints
from capture2vr.edge.mesh.band import NEAR_ZERO, Band, crosses
from capture2vr.edge.mesh.grid import Grid

VOTES = 3  # rounds: three correct all but strips of noise
OUTVOTED = 3  # odd faces, of four, from which on an edge is flipped
UNSURE_COS = 0.5  # an uncrossed edge may be flipped only where its gradients part by more than 60 degrees


@dataclass(frozen=True, slots=True)
class Crossings:
    """Crossed edges: corner (E,) key of the lower end, axis (E,), xyz (E,3) of the crossing, normal (E,3) to +axis."""

    corner: Ints
    axis: Ints
    xyz: Floats
    normal: Floats


def find_crossings(band: Band, grid: Grid) -> Crossings:
    """Find all crossed edges of a band, and correct them by the vote."""
    nexts = [band.neighbours(axis) for axis in range(3)]
    crossed, unsure = _by_gradient(band, nexts, grid.side)
    _vote(crossed, unsure, nexts)
    parts = [_locate(band, grid, np.flatnonzero(crossed[:-1, axis]), nexts[axis], axis) for axis in range(3)]
    return Crossings(*(np.concatenate([getattr(part, name) for part in parts]) for name in Crossings.__slots__))


def _by_gradient(band: Band, nexts: list[Ints], side: float) -> tuple[Bools, Bools]:
    """Masks (M+1,3): crossed edges, and uncrossed ones that a vote may flip. The last row is for missing corners."""
    crossed = np.zeros((len(band.keys) + 1, 3), bool)
    unsure = np.zeros_like(crossed)
    for axis, following in enumerate(nexts):
        a = np.flatnonzero(following < len(band.keys))
        b = following[a]
        d, e, g, k = band.distance[a], band.distance[b], band.gradient[a], band.gradient[b]
        crossed[a, axis] = crosses(d, g, e, k, axis, side, band.floor)
        near = d + e < NEAR_ZERO * side + 2 * band.floor
        unsure[a, axis] = (np.einsum("nx,nx->n", g, k) < UNSURE_COS) & near
    return crossed, unsure


def _vote(crossed: Bools, unsure: Bools, nexts: list[Ints]) -> None:
    """Flip outvoted edges between crossed and uncrossed, in place."""
    last = len(crossed) - 1
    ahead = [np.append(n, last) for n in nexts]
    for _ in range(VOTES):
        odd_faces = np.zeros(crossed.shape, np.int8)
        for normal in range(3):
            a, b = (normal + 1) % 3, (normal + 2) % 3
            odd = crossed[:, a] ^ crossed[ahead[b], a] ^ crossed[:, b] ^ crossed[ahead[a], b]
            odd &= (ahead[a] < last) & (ahead[b] < last)
            for axis, across in ((a, b), (b, a)):
                odd_faces[:, axis] += odd
                odd_faces[ahead[across][odd], axis] += 1
        flipped = (odd_faces >= OUTVOTED) & (crossed | unsure)
        flipped[last] = False
        if not flipped.any():
            return
        crossed ^= flipped


def _locate(band: Band, grid: Grid, a: Ints, following: Ints, axis: int) -> Crossings:
    """Compute the crossings at t = f_a/(f_a+f_b) along their edges."""
    b = following[a]
    total = np.maximum(band.distance[a] + band.distance[b], 1e-12)  # both ends on the surface: any t will do
    xyz = grid.xyz_of(band.keys[a])
    xyz[:, axis] += grid.side * band.distance[a] / total
    normal = (band.gradient[b] - band.gradient[a]).astype(np.float64)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    normal *= np.where(normal[:, [axis]] < 0, -1.0, 1.0)
    return Crossings(band.keys[a], np.full(len(a), axis), xyz, normal)
