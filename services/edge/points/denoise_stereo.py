"""Denoise stereo points by projecting them onto planes fitted to their neighbours (moving least squares).

A depth sensor's errors differ from pixel to pixel, so averaging removes them. Stereo matches windows, so its errors are
correlated over several pixels: ripples, which an average within a voxel does not flatten, and which a field would fit
as if they were shape.
"""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Floats, Ints, Tick, no_tick
from capture2vr.edge.field.eigen import smallest_eigenvectors
from capture2vr.edge.parallel import in_threads, slices

NEIGHBOURS = (32, 20)
"""Number of neighbours in each of the two rounds; the first is wider than the ripples. Planes, not quadrics: quadrics
are 1 % more accurate and take twice the time. 48 and 32 neighbours take detail off (statue, within .5 % of the other
program's points: 94.5 % of them instead of 95.1), with 24 and 16 rims are ragged (95.4; a dress's border is a seventh
longer)."""
_WIDER = 1.05
"""Radius of the weight over the farthest neighbour's distance, so that this neighbour keeps a tenth of the weight."""
_CHUNK = 4_096
"""Points per task of a thread."""


def smooth_stereo_points(
    xyz: Floats, weight: Floats, tick: Tick = no_tick, *, neighbours: tuple[int, int] = NEIGHBOURS
) -> Floats:
    """Move points (N,3) with weights (N,) along their normals onto planes fitted to their neighbours; in their order.

    A neighbour's weight is multiplied by 1 − d²/R². A cloud with fewer points than neighbours is returned unchanged.
    `tick` is called between chunks, on the caller's thread. Raises what it raises.
    """
    from scipy.spatial import cKDTree

    wide, narrow = neighbours
    if len(xyz) <= wide:
        return xyz
    tree = cKDTree(xyz)
    nearest = np.empty((len(xyz), narrow + 1), np.int32)  # points move too little to get other neighbours

    def look(part: slice) -> Floats:
        _, index = tree.query(xyz[part], k=wide + 1)
        nearest[part] = index[:, : narrow + 1]
        return _onto_planes(xyz, weight, part, index)

    parts = slices(len(xyz), _CHUNK)
    once = np.concatenate(in_threads(look, parts, lambda part: tick(0.7 * part)))
    again = in_threads(
        lambda part: _onto_planes(once, weight, part, nearest[part]), parts, lambda part: tick(0.7 + 0.3 * part)
    )
    return np.concatenate(again)


def _onto_planes(xyz: Floats, weight: Floats, part: slice, index: Ints) -> Floats:
    """Project a part of the points onto the weighted least-squares planes of their neighbours, index (n,K): (n,3)."""
    relative = xyz[index] - xyz[part, None]
    distance = np.sqrt(np.einsum("nkx,nkx->nk", relative, relative))
    radius = np.maximum(_WIDER * distance.max(axis=1, keepdims=True), np.finfo(np.float64).tiny)  # duplicates: 0
    near = (1 - np.square(distance / radius)) * weight[index]
    near /= np.maximum(near.sum(axis=1, keepdims=True), np.finfo(np.float64).tiny)
    mean = np.einsum("nk,nkx->nx", near, relative)
    centred = relative - mean[:, None]
    covariance = np.matmul((centred * near[..., None]).transpose(0, 2, 1), centred)
    normal = smallest_eigenvectors(covariance)
    moved: Floats = xyz[part] + np.einsum("nx,nx->n", mean, normal)[:, None] * normal
    return moved
