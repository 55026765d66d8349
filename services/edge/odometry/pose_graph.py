"""Poses that agree with what was measured between pairs of them, by sparse least squares.

Symbols: T_i = camera-to-world of camera i; Z = measured pose of camera j in camera i. The error of an edge is the
motion (ω, t) of E = T_i⁻¹·T_j·Z⁻¹, weighted by the square root of its information. With T·exp(δ) for a change of pose,
E(δ) = exp(-δ_i)·exp(Ad(T_i⁻¹·T_j)·δ_j)·E, so the Jacobian is -1 by δ_i and Ad(T_i⁻¹·T_j) by δ_j where E is small.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from services.edge.arrays import Floats
from services.edge.points.icp import cross_matrix

_ALIKE = 400.0
"""Neighbouring pixels err alike (smoothing, calibration): so many count as one measurement, 20 x 20 of them."""
_MAX_STEPS = 50


@dataclass(frozen=True, slots=True)
class Edge:
    """Camera `source` as seen from camera `target`: pose (4,4) source to target, information (6,6) of (ω, t)."""

    target: int
    source: int
    pose: Floats
    information: Floats


def settle(poses: Floats, edges: Sequence[Edge]) -> Floats:
    """(K,4,4) camera-to-world that fit the edges best, the first one kept; a wrong edge hardly counts."""
    from scipy.optimize import least_squares

    if len(poses) < 2:
        return poses
    roots = [np.linalg.cholesky(_regular(edge.information) / _ALIKE).T for edge in edges]
    # Each solution starts from the last, where the changes are 0 and the Jacobian is exact but for E's own size.
    for _ in range(2):
        solved = least_squares(
            lambda change, at=poses: _errors(_changed(at, change), edges, roots),
            np.zeros(6 * (len(poses) - 1)),
            jac=lambda change, at=poses: _jacobian(_changed(at, change), edges, roots),
            loss="soft_l1",
            tr_solver="lsmr",
            x_scale="jac",
            max_nfev=_MAX_STEPS,
        )
        poses = _changed(poses, solved.x)
    return poses


def _regular(information: Floats) -> Floats:
    """Positive definite in spite of rounding."""
    symmetric: Floats = (information + information.T) / 2
    return symmetric + 1e-9 * np.diag(np.diag(symmetric)) + 1e-9 * np.eye(6)


def _changed(poses: Floats, change: Floats) -> Floats:
    """T·exp(δ), with the rotation and the shift of δ taken one after the other; the first pose stays."""
    moved = poses.copy()
    steps = change.reshape(-1, 6)
    moved[1:, :3, 3] += np.einsum("kij,kj->ki", poses[1:, :3, :3], steps[:, 3:])
    moved[1:, :3, :3] = poses[1:, :3, :3] @ Rotation.from_rotvec(steps[:, :3]).as_matrix()
    return moved


def _errors(poses: Floats, edges: Sequence[Edge], roots: Sequence[Floats]) -> Floats:
    parts = []
    for edge, root in zip(edges, roots, strict=True):
        gap = np.linalg.inv(poses[edge.target]) @ poses[edge.source] @ np.linalg.inv(edge.pose)
        parts.append(root @ np.concatenate([Rotation.from_matrix(gap[:3, :3]).as_rotvec(), gap[:3, 3]]))
    return np.concatenate(parts)


def _jacobian(poses: Floats, edges: Sequence[Edge], roots: Sequence[Floats]) -> Any:
    """Sparse (6·edges, 6·(K-1)); the first pose has no columns."""
    from scipy.sparse import csr_array

    rows, columns, values = [], [], []
    inner_row, inner_column = np.mgrid[:6, :6]
    for number, (edge, root) in enumerate(zip(edges, roots, strict=True)):
        between = np.linalg.inv(poses[edge.target]) @ poses[edge.source]
        for camera, block in ((edge.target, -root), (edge.source, root @ _adjoint(between))):
            if camera:
                rows.append(6 * number + inner_row)
                columns.append(6 * (camera - 1) + inner_column)
                values.append(block)
    flat = [np.concatenate([part.ravel() for part in parts]) for parts in (rows, columns, values)]
    return csr_array((flat[2], (flat[0], flat[1])), shape=(6 * len(edges), 6 * (len(poses) - 1)))


def _adjoint(pose: Floats) -> Floats:
    """(6,6) that takes a motion (ω, t) from before a pose to after it."""
    turn = pose[:3, :3]
    adjoint = np.zeros((6, 6))
    adjoint[:3, :3] = adjoint[3:, 3:] = turn
    adjoint[3:, :3] = cross_matrix(pose[:3, 3]) @ turn
    return adjoint
