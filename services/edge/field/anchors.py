"""The field of curved patches, one at every point: what `anchor_fit.py` trains.

x_i, (u_i, v_i, n_i), h_i   an anchor: a point, a frame whose third axis is the normal, the local spacing (`planes.py`)
b_i(x,y)                    the base: the local field's patch there (`patches.py`), as far as its neighbours support it
θ_i = (o, a, b, c₁, c₂, c₃)  what is trained, in spacings: offset along the normal, two slopes, three curvatures
z_i(x,y) = b_i + o + a x + b y + ½(c₁x² + 2c₂xy + c₃y²)       the patch over the frame; beyond 2.5 spacings the trained
                                                             part is its tangent plane
d_i(q), g_i(q)               the signed distance to the patch to first order, (z − z_i)/√(1+|∇z_i|²), and its gradient

For a query q, 0 being the index of the nearest anchor, i running over the nearest few, s_i = sign(g_i·g_0):

    w_i = exp(−(|q−x_i|² − |q−x_0|²)/h_0²)                     nearer patches count more
          · exp(−((s_i d_i − d_0) / ½h_0)²) · |g_i·g_0|³       a patch with the surface elsewhere is another layer's
    d = Σ w_i s_i d_i,   n = Σ w_i s_i g_i, normalised          with Σ w_i = 1
    t = max(0, |q−x_0 along the patch's plane| − h_0)           beyond an open edge
    f = √(d² + t²),   gradient = sign(d)·n
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Floats, Ints
from capture2vr.edge.field.local import by_chunks
from capture2vr.edge.field.patches import LENGTH, TERMS, Patches, patch_surface
from capture2vr.edge.field.quadrics import TINY

SHAPE = 6  # numbers per anchor
BLEND = 8  # patches per query: 12 smear sparse pleats
LAYER = 0.5  # in spacings: how far a patch's distance may differ from the nearest one's before it is another layer's
ALIGNMENT_POWER = 3  # of |cos|: 2 and 4 are as good
# Support of a patch (share of its neighbours that it explains) at which its base starts to count, and counts fully.
# A start at 0.6 loses 3 % on the dress, one at 0.8 loses 7 % on bumps as small as the spacing.
SUPPORTED = (0.7, 1.0)
PATCH = 2.5  # spacings: radius of the neighbours that shape a patch; farther out its parabola would be a guess


@dataclass(frozen=True, slots=True)
class Anchors:
    """xyz (N,3); frame (N,3,3), its rows u, v, n; spacing (N,); terms (N,15) of b; shape (N,6): float32, unit frame."""

    xyz: Floats
    frame: Floats
    spacing: Floats
    terms: Floats
    shape: Floats


def curved_anchors(patches: Patches) -> Anchors:
    """Make anchors from the local field's patches: the whole patch where its neighbours support it, else its parabola.

    The terms beyond the parabola follow bumps smaller than the spacing where the neighbours lie on the patch, and come
    from another layer where they do not. The parabola goes into `shape`, which training may change freely.
    """
    frame = np.stack([patches.u, patches.v, patches.normals], axis=1)
    share = np.clip((patches.support - SUPPORTED[0]) / (SUPPORTED[1] - SUPPORTED[0]), 0, 1).astype(np.float32)[:, None]
    of = dict(zip(TERMS, patches.terms.T, strict=True))
    # φ₀₀ = exp(−½(s²+t²)) bends too.
    bends = [2 * of[2, 0] - of[0, 0], of[1, 1], 2 * of[0, 2] - of[0, 0]]
    parabola = [np.zeros_like(of[0, 0]), of[1, 0] / LENGTH, of[0, 1] / LENGTH]
    parabola += [bend / (LENGTH * LENGTH) for bend in bends]
    shape = (1 - share) * np.stack(parabola, axis=1)
    # A patch misses its point by a little; from the shifted place it passes through the point.
    shifted = patches.xyz - share * of[0, 0][:, None] * patches.spacing[:, None] * patches.normals
    return Anchors(shifted, frame, patches.spacing, share * patches.terms, shape.astype(np.float32))


def surface_at(anchors: Anchors) -> tuple[Floats, Floats]:
    """Evaluate each patch at its own point: return the surface positions (N,3) and the unit normals (N,3) there."""
    height, slope_u, slope_v = base(anchors.terms, np.zeros((len(anchors.xyz), 2), np.float32))
    offset, along_u, along_v = (anchors.shape[:, :3] + np.stack([height, slope_u, slope_v], axis=1)).T[..., None]
    u, v, n = anchors.frame.transpose(1, 0, 2)
    return anchors.xyz + offset * anchors.spacing[:, None] * n, _unit(n - along_u * u - along_v * v)


def base(terms: Floats, places: Floats) -> tuple[Floats, Floats, Floats]:
    """Evaluate b of patches (...,15) at places (...,2) in spacings -> height in spacings, slopes along u and v."""
    return patch_surface(terms, places[..., 0] / LENGTH, places[..., 1] / LENGTH)[:3]


class AnchorField:
    """The `DistanceFn` of anchors: distances (M,) and gradients (M,3) of length 1, float32."""

    def __init__(self, anchors: Anchors) -> None:
        self._anchors = anchors

    @cached_property
    def points(self) -> Floats:
        """(N,3) the trained surface at each point, from which the extraction should start."""
        return surface_at(self._anchors)[0]

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.points)

    def __call__(self, queries: Floats) -> tuple[Floats, Floats]:
        _ = self._tree  # built before the threads start, so that it is built once
        return by_chunks(self._blend, queries)

    def _blend(self, q: Floats) -> tuple[Floats, Floats]:
        """Blend the patches by the formulas at the head of this file, for one chunk of queries (M,3)."""
        away, index = self._tree.query(q, k=min(BLEND, len(self.points)))
        away = np.asarray(away, np.float32)
        spacing = self._anchors.spacing[index[:, 0]]
        signed, slope = _evaluate_patches(self._anchors, q, index)
        facing = slope[:, 0]
        cos = np.einsum("mkx,mx->mk", slope, facing)
        sign = np.where(cos < 0, np.float32(-1), np.float32(1))
        layer = (sign * signed - signed[:, :1]) / (LAYER * spacing[:, None])
        near = (np.square(away) - np.square(away[:, :1])) / np.square(spacing)[:, None]
        weights = np.exp(-near - np.square(layer)) * np.abs(cos) ** ALIGNMENT_POWER
        weights *= sign / (weights.sum(axis=1, keepdims=True) + np.float32(TINY))
        distance = np.einsum("mk,mk->m", weights, signed)
        normal = _unit(np.einsum("mk,mkx->mx", weights, slope))
        normal[distance < 0] *= -1
        across = np.einsum("mx,mx->m", q - self.points[index[:, 0]], facing)
        along = np.sqrt(np.maximum(np.square(away[:, 0]) - np.square(across), 0))
        beyond = np.maximum(along - spacing, 0)
        return np.sqrt(np.square(distance) + np.square(beyond)), normal


def _evaluate_patches(anchors: Anchors, q: Floats, index: Ints) -> tuple[Floats, Floats]:
    """Signed distances (M,K) of queries (M,3) to the patches index (M,K), and their unit gradients (M,K,3)."""
    frame, spacing, shape = anchors.frame[index], anchors.spacing[index], anchors.shape[index]
    local = np.matmul(frame, (q[:, None] - anchors.xyz[index])[..., None])[..., 0] / spacing[..., None]
    x, y = local[..., 0], local[..., 1]
    inside = np.minimum(1, PATCH / np.maximum(np.sqrt(x * x + y * y), PATCH))
    x_in, y_in = x * inside, y * inside
    o, a, b, c1, c2, c3 = np.moveaxis(shape, -1, 0)
    slope_x, slope_y = a + c1 * x_in + c2 * y_in, b + c2 * x_in + c3 * y_in
    height = o + (a + slope_x) * x_in / 2 + (b + slope_y) * y_in / 2
    height += slope_x * (x - x_in) + slope_y * (y - y_in)
    base_height, base_x, base_y = base(anchors.terms[index], local[..., :2])
    height, slope_x, slope_y = height + base_height, slope_x + base_x, slope_y + base_y
    gradient = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], axis=-1)
    gradient /= np.sqrt(1 + slope_x * slope_x + slope_y * slope_y)[..., None]
    signed = (local[..., 2] - height) * gradient[..., 2] * spacing
    return signed, np.matmul(gradient[..., None, :], frame)[..., 0, :]


def _unit(vectors: Floats) -> Floats:
    unit: Floats = vectors / (np.linalg.norm(vectors, axis=1, keepdims=True) + np.float32(TINY))
    return unit
