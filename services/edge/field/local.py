"""The local field: the unsigned distance as a blend of the patches at the nearest points, without training.

x_i, h_i        a point and the local spacing;  F_i(q), n_i(q)   distance and normal that its patch gives (`patches.py`)
q               a query; 0 is the index of its nearest point, i runs over its nearest few

    s_i = sign(n_i·n_0)                                               no global sign exists: signs follow the nearest
    w_i = exp(−(|q−x_i|² − |q−x_0|²)/h_0²)                            nearer patches count more
          · exp(−((s_i F_i − F_0)/0.35h_0)²) · |n_i·n_0|⁴             excludes another layer (a bilateral weight)
    n   = Σ w_i s_i n_i, normalised                                   with Σ w_i = 1
    d   = Σ w_i s_i F_i
    t   = max(0, |q−x_0 along the plane| − h_0)                       beyond an open edge
    f   = √(d² + t²),   gradient = sign(d)·n

With a better supported patch instead of the nearest as number 0 normals improve but layers are lost: the car's normals
on its own surface .917 → .924, but its area .75 → .69 of the truth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import DistanceFn, Floats, Tick, no_tick
from capture2vr.edge.field.patches import Patches, fit_patches, predict
from capture2vr.edge.field.planes import fit_planes
from capture2vr.edge.field.quadrics import TINY
from capture2vr.edge.parallel import in_threads, slices

BLEND = 8  # patches per query: 6 lose 1 % where points are sparse, 12 gain 2 % for half as much time again
LAYER = 0.35  # in spacings: how far two patches may differ at the query before they count as two layers
ALIGNMENT_POWER = 4  # a patch at 45° to the nearest counts a quarter
PLANES_SHARE = 0.2  # of the time to fit the field, for the progress
CHUNK = 4_096  # queries at once: 8 patches × 15 terms × 4 B are 2 MB, so the arrays in use stay in the cache


@dataclass(frozen=True, slots=True)
class LocalField:
    """The local field as a `DistanceFn`: distances (M,) and gradients (M,3), float32, unit frame.

    The gradient is the direction across the surface, also beyond an open edge, where the distance grows sideways: the
    extraction asks on which side a query lies, not which way the distance falls.
    """

    patches: Patches
    tree: cKDTree

    def __call__(self, queries: Floats) -> tuple[Floats, Floats]:
        return by_chunks(self._blend, queries)

    def _blend(self, q: Floats) -> tuple[Floats, Floats]:
        """Blend the patches by the formulas at the head of this file, for one chunk of queries (M,3)."""
        away, index = self.tree.query(q, k=min(BLEND, len(self.patches.xyz)))
        squared = np.square(away.astype(np.float32))
        spacing = self.patches.spacing[index[:, :1]]
        distance, normals = predict(self.patches, index, q)
        cos = np.einsum("mkx,mx->mk", normals, normals[:, 0])
        sign = np.where(cos < 0, np.float32(-1), np.float32(1))
        distance = distance * sign
        near = (squared - squared[:, :1]) / np.square(spacing)
        apart = (distance - distance[:, :1]) / (LAYER * spacing)
        weights = np.exp(-near - np.square(apart)) * np.abs(cos) ** ALIGNMENT_POWER
        weights /= weights.sum(axis=1, keepdims=True) + np.float32(TINY)
        signed = np.einsum("mk,mk->m", weights, distance)
        normal = np.einsum("mk,mkx->mx", weights * sign, normals)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True) + np.float32(TINY)
        normal[signed < 0] *= -1
        nearest = index[:, 0]
        across = np.einsum("mx,mx->m", q - self.patches.xyz[nearest], self.patches.normals[nearest])
        along = np.sqrt(np.maximum(squared[:, 0] - np.square(across), 0))
        beyond = np.maximum(along - spacing[:, 0], 0)
        return np.sqrt(np.square(signed) + np.square(beyond)), normal


def by_chunks(blend: DistanceFn, queries: Floats) -> tuple[Floats, Floats]:
    """Evaluate a field at queries (M,3) in threads, by chunks that fit the cache: distances (M,), gradients (M,3)."""
    q = np.asarray(queries, np.float32)
    f, gradient = np.empty(len(q), np.float32), np.empty((len(q), 3), np.float32)

    def evaluate(part: slice) -> None:
        f[part], gradient[part] = blend(q[part])

    in_threads(evaluate, slices(len(q), CHUNK))
    return f, gradient


def local_field(xyz_unit: Floats, *, normals: Floats | None = None, tick: Tick = no_tick) -> LocalField:
    """Fit the local field to points (N,3) in the unit frame, N ≥ 2.

    normals (N,3), where they are known, may have any sign and length. `tick` is called between chunks; its errors pass
    through. Raises ValueError for other shapes, for too few points and for NaN or infinity.
    """
    xyz = np.ascontiguousarray(xyz_unit, np.float32)
    if xyz.ndim != 2 or xyz.shape[1] != 3 or len(xyz) < 2:
        raise ValueError(f"a local field needs (N,3) points with N ≥ 2, not {xyz.shape}")
    if not np.isfinite(xyz).all():
        raise ValueError(f"{int((~np.isfinite(xyz)).any(axis=1).sum())} points are not finite")
    if normals is not None and np.shape(normals) != xyz.shape:
        raise ValueError(f"the normals' shape {np.shape(normals)} differs from the points' {xyz.shape}")
    tree = cKDTree(xyz)
    planes = fit_planes(xyz, tree, normals, tick=lambda part: tick(PLANES_SHARE * part))
    later = PLANES_SHARE, 1 - PLANES_SHARE
    patches = fit_patches(planes, tree, trusted=normals is not None, tick=lambda part: tick(later[0] + later[1] * part))
    return LocalField(patches, tree)
