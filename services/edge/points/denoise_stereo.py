"""Points of stereo onto the surface that they mean.

A depth sensor errs pixel by pixel, and averages take that off. Stereo compares windows, so that its errors are alike
over several pixels: ripples, which no average within a voxel flattens and which a field would take for shape.
"""

from __future__ import annotations

import numpy as np

from services.edge.arrays import Floats, Tick, no_tick
from services.edge.threads import in_threads, slices

NEIGHBOURS = (48, 32)
"""Of each round: wider than the ripples first. Planes, not quadrics: those are 1 % nearer and take twice the time."""
_WIDER = 1.05
"""Of the farthest neighbour's distance, so that it keeps a tenth of the weight."""
_CHUNK = 4_096


def smoothed(xyz: Floats, weight: Floats, tick: Tick = no_tick, *, neighbours: tuple[int, int] = NEIGHBOURS) -> Floats:
    """Points (N,3) with weights (N,) moved along their normals onto planes through their neighbours; the same order.

    A neighbour counts by its weight and by 1 − d²/R². Clouds of fewer points than neighbours come back as they are.
    `tick` is called between chunks, on the caller's thread. Raises what it raises.
    """
    wide, narrow = neighbours
    xyz = _onto_planes(xyz, weight, wide, lambda part: tick(0.6 * part))
    return _onto_planes(xyz, weight, narrow, lambda part: tick(0.6 + 0.4 * part))


def _onto_planes(xyz: Floats, weight: Floats, neighbours: int, tick: Tick) -> Floats:
    from scipy.spatial import cKDTree

    if len(xyz) <= neighbours:
        return xyz
    tree = cKDTree(xyz)
    moved = xyz.copy()

    def work(part: slice) -> None:
        distance, index = tree.query(xyz[part], k=neighbours + 1)
        relative = xyz[index] - xyz[part, None]
        radius = np.maximum(_WIDER * distance[:, -1:], np.finfo(np.float64).tiny)  # copies of one point
        near = (1 - np.square(distance / radius)) * weight[index]
        near /= np.maximum(near.sum(axis=1, keepdims=True), np.finfo(np.float64).tiny)
        mean = np.einsum("nk,nkx->nx", near, relative)
        centred = relative - mean[:, None]
        covariance = np.matmul((centred * near[..., None]).transpose(0, 2, 1), centred)
        normal = np.linalg.eigh(covariance)[1][:, :, 0]
        moved[part] += np.einsum("nx,nx->n", mean, normal)[:, None] * normal

    in_threads(work, slices(len(xyz), _CHUNK), tick)
    return moved
