"""Denoise stereo points by projecting them onto planes fitted to their neighbours (moving least squares).

A depth sensor's errors differ from pixel to pixel, so averaging removes them. Stereo matches windows, so its errors are
correlated over several pixels: ripples, which an average within a voxel does not flatten, and which a field would fit
as if they were shape.
"""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Floats, Tick, no_tick
from capture2vr.edge.parallel import in_threads, slices

NEIGHBOURS = (48, 32)
"""Number of neighbours in each of the two rounds; the first is wider than the ripples. Planes, not quadrics: quadrics
are 1 % more accurate and take twice the time."""
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
    wide, narrow = neighbours
    xyz = _onto_planes(xyz, weight, wide, lambda part: tick(0.6 * part))
    return _onto_planes(xyz, weight, narrow, lambda part: tick(0.6 + 0.4 * part))


def _onto_planes(xyz: Floats, weight: Floats, neighbours: int, tick: Tick) -> Floats:
    """Project every point onto the weighted least-squares plane of its neighbours: one round."""
    from scipy.spatial import cKDTree

    if len(xyz) <= neighbours:
        return xyz
    tree = cKDTree(xyz)
    moved = xyz.copy()

    def work(part: slice) -> None:
        distance, index = tree.query(xyz[part], k=neighbours + 1)
        relative = xyz[index] - xyz[part, None]
        radius = np.maximum(_WIDER * distance[:, -1:], np.finfo(np.float64).tiny)  # duplicates: distance 0
        near = (1 - np.square(distance / radius)) * weight[index]
        near /= np.maximum(near.sum(axis=1, keepdims=True), np.finfo(np.float64).tiny)
        mean = np.einsum("nk,nkx->nx", near, relative)
        centred = relative - mean[:, None]
        covariance = np.matmul((centred * near[..., None]).transpose(0, 2, 1), centred)
        normal = np.linalg.eigh(covariance)[1][:, :, 0]
        moved[part] += np.einsum("nx,nx->n", mean, normal)[:, None] * normal

    in_threads(work, slices(len(xyz), _CHUNK), tick)
    return moved
