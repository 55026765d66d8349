"""The field without training: the blended tangent planes of the points.

x_i, n_i, h_i   a point, the normal of its plane and the local spacing (`planes.py`)
q               a query; 0 is the index of its nearest point, i runs over its nearest few

    s_i = sign(n_i·n_0)                                               no global sign exists: all agree with the nearest
    w_i = exp(−(|q−x_i|² − |q−x_0|²)/h_0²)                            near counts most
          · exp(−(n_0·(x_i−x_0) / ½h_0)²) · |n_i·n_0|⁴                another layer does not count (a bilateral weight)
    n   = Σ w_i s_i n_i, normalised                                   with Σ w_i = 1
    d   = Σ w_i ½(s_i n_i + n)·(q−x_i)                                the mean of both normals is exact on a sphere;
                                                                      planes alone would lie outside every bend
    t   = max(0, |q−x_0 along the plane| − h_0)                       beyond an open edge
    f   = √(d² + t²),   gradient = sign(d)·n
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from services.edge.arrays import DistanceFn, Floats
from services.edge.field.planes import Planes, fit_planes
from services.edge.field.quadrics import TINY
from services.edge.threads import in_threads, slices

LAYER = 0.5  # in spacings: how far off the nearest point's plane another point may lie before it is another layer's
BLEND = 8  # planes per query: with 4 the surface shows the cells of the points, more than 8 only cost time
ALIGNMENT_POWER = 4  # a plane at 45° to the nearest counts a quarter
CHUNK = 8_192  # queries at once: 8 planes × 3 × 4 B are 0.8 MB an array, so the dozen in use stay in the cache


def local_field(xyz_unit: Floats, *, normals: Floats | None = None) -> DistanceFn:
    """Points (N,3) in the unit frame, N ≥ 2, and where known their normals (N,3), of any sign and length -> the field.

    The field's distances (M,) and gradients (M,3) are float32. Its gradient is the direction across the surface, also
    beyond an open edge, where the distance grows sideways: the extraction asks on which side a query lies, not which
    way the distance falls. Raises ValueError for other shapes, for too few points and for NaN or infinity.
    """
    xyz = np.ascontiguousarray(xyz_unit, np.float32)
    if xyz.ndim != 2 or xyz.shape[1] != 3 or len(xyz) < 2:
        raise ValueError(f"a local field needs (N,3) points with N ≥ 2, not {xyz.shape}")
    if not np.isfinite(xyz).all():
        raise ValueError(f"{int((~np.isfinite(xyz)).any(axis=1).sum())} points are not finite")
    if normals is not None and np.shape(normals) != xyz.shape:
        raise ValueError(f"{np.shape(normals)} normals do not fit {xyz.shape} points")
    tree = cKDTree(xyz)
    planes = fit_planes(xyz, tree, normals)

    def distance(queries: Floats) -> tuple[Floats, Floats]:
        q = np.asarray(queries, np.float32)
        f, gradient = np.empty(len(q), np.float32), np.empty((len(q), 3), np.float32)

        def evaluate(part: slice) -> None:
            f[part], gradient[part] = _blend(q[part], tree, planes)

        in_threads(evaluate, slices(len(q), CHUNK))
        return f, gradient

    return distance


def _blend(q: Floats, tree: cKDTree, planes: Planes) -> tuple[Floats, Floats]:
    """The formulas at the head of this file, for one chunk of queries (M,3)."""
    away, index = tree.query(q, k=min(BLEND, len(planes.xyz)))
    away = away.astype(np.float32)
    points, normals = planes.xyz[index], planes.normals[index]
    nearest, facing, spacing = points[:, 0], normals[:, 0], planes.spacing[index[:, 0]]
    cos = np.einsum("mkx,mx->mk", normals, facing)
    layer = np.einsum("mkx,mx->mk", points - nearest[:, None], facing) / (LAYER * spacing[:, None])
    near = (np.square(away) - np.square(away[:, :1])) / np.square(spacing)[:, None]
    weights = np.exp(-near - np.square(layer)) * np.abs(cos) ** ALIGNMENT_POWER
    weights /= weights.sum(axis=1, keepdims=True) + np.float32(TINY)
    weights *= np.where(cos < 0, np.float32(-1), np.float32(1))
    normal = np.einsum("mk,mkx->mx", weights, normals)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True) + np.float32(TINY)
    aside = q[:, None] - points
    own = np.einsum("mk,mk->m", weights, np.einsum("mkx,mkx->mk", aside, normals))
    here = np.einsum("mx,mx->m", normal, np.einsum("mk,mkx->mx", np.abs(weights), aside))
    signed = (own + here) / 2
    normal[signed < 0] *= -1
    across = np.einsum("mx,mx->m", q - nearest, facing)
    along = np.sqrt(np.maximum(np.square(away[:, 0]) - np.square(across), 0))
    beyond = np.maximum(along - spacing, 0)
    return np.sqrt(np.square(signed) + np.square(beyond)), normal
