"""Pose graph optimisation: find the poses that fit the measured relative poses best, by sparse least squares.

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
from services.edge.odometry.icp import cross_matrix

_PIXELS_PER_MEASUREMENT = 400.0
"""Pixels that count as one measurement, 20 x 20: errors of neighbours are correlated, by smoothing and calibration."""
_MAX_STEPS = 50
"""Most evaluations of the solver per round."""


@dataclass(frozen=True, slots=True)
class Edge:
    """Measured pose of camera `source` in camera `target`: pose (4,4) source to target, information (6,6) of (ω, t)."""

    target: int
    source: int
    pose: Floats
    information: Floats


def optimise_poses(poses: Floats, edges: Sequence[Edge]) -> Floats:
    """Fit camera-to-world poses (K,4,4) to the edges; the first pose is fixed, and wrong edges have little weight."""
    from scipy.optimize import least_squares

    if len(poses) < 2:
        return poses
    roots = [np.linalg.cholesky(_regularise(edge.information) / _PIXELS_PER_MEASUREMENT).T for edge in edges]
    # The second round starts at the first one's solution, where the Jacobian is exact except for the size of E.
    for _ in range(2):
        solved = least_squares(
            lambda change, at=poses: _errors(_apply_changes(at, change), edges, roots),
            np.zeros(6 * (len(poses) - 1)),
            jac=lambda change, at=poses: _jacobian(_apply_changes(at, change), edges, roots),
            loss="soft_l1",
            tr_solver="lsmr",
            x_scale="jac",
            max_nfev=_MAX_STEPS,
        )
        poses = _apply_changes(poses, solved.x)
    return poses


def _regularise(information: Floats) -> Floats:
    """Return the information matrix symmetric and positive definite, in spite of rounding."""
    symmetric: Floats = (information + information.T) / 2
    return symmetric + 1e-9 * np.diag(np.diag(symmetric)) + 1e-9 * np.eye(6)


def _apply_changes(poses: Floats, change: Floats) -> Floats:
    """Apply changes to all poses but the first: T·exp(δ), with the rotation and the translation of δ separately."""
    moved = poses.copy()
    steps = change.reshape(-1, 6)
    moved[1:, :3, 3] += np.einsum("kij,kj->ki", poses[1:, :3, :3], steps[:, 3:])
    moved[1:, :3, :3] = poses[1:, :3, :3] @ Rotation.from_rotvec(steps[:, :3]).as_matrix()
    return moved


def _errors(poses: Floats, edges: Sequence[Edge], roots: Sequence[Floats]) -> Floats:
    """Return the weighted errors of all edges (6·edges,)."""
    parts = []
    for edge, root in zip(edges, roots, strict=True):
        gap = np.linalg.inv(poses[edge.target]) @ poses[edge.source] @ np.linalg.inv(edge.pose)
        parts.append(root @ np.concatenate([Rotation.from_matrix(gap[:3, :3]).as_rotvec(), gap[:3, 3]]))
    return np.concatenate(parts)


def _jacobian(poses: Floats, edges: Sequence[Edge], roots: Sequence[Floats]) -> Any:
    """Return the sparse Jacobian (6·edges, 6·(K-1)) of the errors; the first pose has no columns."""
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
    """Return the adjoint (6,6) of a pose: it transforms a motion (ω, t) from the pose's source frame to its target."""
    turn = pose[:3, :3]
    adjoint = np.zeros((6, 6))
    adjoint[:3, :3] = adjoint[3:, 3:] = turn
    adjoint[3:, :3] = cross_matrix(pose[:3, 3]) @ turn
    return adjoint
