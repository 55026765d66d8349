"""Closed-form eigenvectors of many symmetric 3×3 matrices at once: the normals of small point sets (PCA).

Trigonometric solution of the characteristic cubic (O. K. Smith, "Eigenvalues of a symmetric 3 × 3 matrix", CACM 1961).
Vectorised, it takes 20 ms for 50,000 matrices, where `np.linalg.eigh` takes 150 ms.
"""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Floats

_TINY = 1e-30  # avoids 0/0 for a set without extent; far below any squared distance in the unit frame


def smallest_eigenvectors(matrices: Floats) -> Floats:
    """Compute the unit eigenvectors (N,3) of the smallest eigenvalues of symmetric matrices (N,3,3).

    float64 throughout: the cubic loses half the digits. A matrix whose smallest eigenvalue is double has no unique
    answer: it gets one of the possible vectors, or zeros.
    """
    m = np.asarray(matrices, np.float64)
    xx, yy, zz = m[:, 0, 0], m[:, 1, 1], m[:, 2, 2]
    xy, xz, yz = m[:, 0, 1], m[:, 0, 2], m[:, 1, 2]
    mean = (xx + yy + zz) / 3
    a, b, c = xx - mean, yy - mean, zz - mean
    scale = np.maximum(np.sqrt((a * a + b * b + c * c + 2 * (xy * xy + xz * xz + yz * yz)) / 6), _TINY)
    # Divide by the scale first: its cube leaves the range of float64 where a set has no extent.
    a, b, c, xy, xz, yz = (entry / scale for entry in (a, b, c, xy, xz, yz))
    half_det = (a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)) / 2
    angle = np.arccos(np.clip(half_det, -1, 1)) / 3
    low = 2 * np.cos(angle + 2 * np.pi / 3)
    return _null_vectors(a - low, b - low, c - low, xy, xz, yz)


def _null_vectors(a: Floats, b: Floats, c: Floats, xy: Floats, xz: Floats, yz: Floats) -> Floats:
    """Null vectors (N,3) of singular symmetric matrices: the longest cross product of two rows, normalised."""
    crosses = np.stack(
        [
            np.stack([xy * yz - xz * b, xz * xy - a * yz, a * b - xy * xy], axis=1),
            np.stack([xy * c - xz * yz, xz * xz - a * c, a * yz - xy * xz], axis=1),
            np.stack([b * c - yz * yz, yz * xz - xy * c, xy * yz - b * xz], axis=1),
        ],
        axis=1,
    )
    squares = np.einsum("nrx,nrx->nr", crosses, crosses)
    best = np.arange(len(crosses)), squares.argmax(axis=1)
    vectors: Floats = crosses[best] / np.sqrt(squares[best] + _TINY)[:, None]
    return vectors
