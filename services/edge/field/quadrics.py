"""Fit planes and quadrics to many small weighted point sets at once.

relative (N,K,3)  neighbours seen from their point;  weights (N,K)
height function   z(x,y) = c₀ + c₁x + c₂y + c₃x² + c₄xy + c₅y² over the tangent plane
"""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Floats
from capture2vr.edge.field.eigen import smallest_eigenvectors

QUADRIC = 6  # coefficients of a quadric height function
TINY = 1e-12  # squared unit-frame lengths below float32's resolution: keeps duplicates from dividing by 0
_RIDGE = 1e-6  # of the weights' sum (ridge regression): a set on a line, or of fewer than 6 points, has one answer too


def weighted_pca(relative: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Fit planes by weighted PCA -> normals (N,3) of either sign, weighted means (N,3)."""
    total = weights.sum(axis=1) + TINY
    mean = np.einsum("nk,nkx->nx", weights, relative) / total[:, None]
    centred = relative - mean[:, None]
    covariance = np.matmul((centred * weights[..., None]).transpose(0, 2, 1), centred) / total[:, None, None]
    return smallest_eigenvectors(covariance), mean


def tangents(normal: Floats) -> tuple[Floats, Floats]:
    """Compute two tangents (N,3), perpendicular to each unit normal (N,3) and to each other."""
    axis = np.eye(3)[np.abs(normal).argmin(axis=1)]
    u = np.cross(normal, axis)
    u /= np.linalg.norm(u, axis=1, keepdims=True) + TINY
    return u, np.cross(normal, u)


def monomials(relative: Floats, u: Floats, v: Floats) -> Floats:
    """The six terms of the height function at each neighbour (N,K,6). Scale `relative` to about 1 beforehand."""
    x = np.einsum("nkx,nx->nk", relative, u)
    y = np.einsum("nkx,nx->nk", relative, v)
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=2)


def fit_quadric(terms: Floats, height: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Fit quadrics by weighted least squares: coefficients (N,6), and the inverse of the normal matrix (N,6,6)."""
    weighted = terms * weights[..., None]
    gram = np.matmul(weighted.transpose(0, 2, 1), terms).astype(np.float64)
    gram += (_RIDGE * weights.sum(axis=1) + TINY)[:, None, None] * np.eye(QUADRIC)
    inverse = np.linalg.inv(gram)
    return np.einsum("nab,nb->na", inverse, np.einsum("nka,nk->na", weighted, height)), inverse
