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

from capture2vr.edge.arrays import Floats, Ints

_PIXELS_PER_MEASUREMENT = 400.0
"""Pixels that count as one measurement, 20 x 20: errors of neighbours are correlated, by smoothing and calibration."""
_STEPS = 60
"""Most Gauss-Newton steps."""
_STILL = 1e-9
"""Largest change, in radians and metres, of a last step."""
_DAMPING = 1e-9
"""Share of the normal equations' diagonal that is added to it: a camera that hardly anything holds stays there."""
_SCALE_FALL = 0.5
"""Factor from step to step of the scale at which an error counts as wrong: from the largest error down to 1, so that
what is wrong shows itself against the many that agree before anything is given up (graduated non-convexity)."""


@dataclass(frozen=True, slots=True)
class Edge:
    """Measured pose of camera `source` in camera `target`: pose (4,4) source to target, information (6,6) of (ω, t)."""

    target: int
    source: int
    pose: Floats
    information: Floats


@dataclass(frozen=True, slots=True)
class _Graph:
    """All edges as arrays: target, source (E,) cameras; back (E,4,4) inverse measured poses; roots (E,6,6) of their
    information; rows, columns: places of the Jacobian's elements, of the targets' blocks and then of the sources'."""

    target: Ints
    source: Ints
    back: Floats
    roots: Floats
    rows: Ints
    columns: Ints

    @classmethod
    def of(cls, edges: Sequence[Edge]) -> _Graph:
        target, source = (np.array(each) for each in zip(*((edge.target, edge.source) for edge in edges), strict=True))
        counted = np.stack([_regularise(edge.information) for edge in edges]) / _PIXELS_PER_MEASUREMENT
        roots = np.linalg.cholesky(counted).transpose(0, 2, 1)
        inner_row, inner_column = np.mgrid[:6, :6]
        row = 6 * np.arange(len(edges))[:, None, None] + inner_row
        columns = np.concatenate([6 * (each[:, None, None] - 1) + inner_column for each in (target, source)])
        back = np.linalg.inv(np.stack([edge.pose for edge in edges]))
        return cls(target, source, back, roots, np.concatenate([row, row]), columns)

    def errors(self, poses: Floats) -> Floats:
        """Weighted errors (E,6) of all edges."""
        gap = np.linalg.inv(poses[self.target]) @ poses[self.source] @ self.back
        motion = np.concatenate([Rotation.from_matrix(gap[:, :3, :3]).as_rotvec(), gap[:, :3, 3]], axis=1)
        errors: Floats = np.einsum("eij,ej->ei", self.roots, motion)
        return errors

    def jacobian(self, poses: Floats, weights: Floats) -> Any:
        """Sparse Jacobian (6·E, 6·(K-1)) of the errors times weights (E,); the first pose has no columns."""
        from scipy.sparse import csc_array

        between = np.linalg.inv(poses[self.target]) @ poses[self.source]
        roots = self.roots * weights[:, None, None]
        values = np.concatenate([-roots, roots @ _adjoints(between)])
        free = self.columns >= 0
        shape = (6 * len(self.target), 6 * (len(poses) - 1))
        return csc_array((values[free], (self.rows[free], self.columns[free])), shape=shape)


def optimise_poses(poses: Floats, edges: Sequence[Edge]) -> Floats:
    """Fit camera-to-world poses (K,4,4) to the edges; the first pose is fixed, and wrong edges have hardly any weight.

    Gauss-Newton steps, reweighted by Cauchy's function of each edge's error. Time grows with the number of edges.
    """
    if len(poses) < 2 or not edges:
        return poses
    graph = _Graph.of(edges)
    scale = float(np.linalg.norm(graph.errors(poses), axis=1).max())
    for _ in range(_STEPS):
        scale = max(scale * _SCALE_FALL, 1.0)
        step = _gauss_newton_step(graph, poses, scale)
        poses = _apply_changes(poses, step)
        if scale == 1.0 and np.abs(step).max() < _STILL:
            break
    return poses


def _gauss_newton_step(graph: _Graph, poses: Floats, scale: float) -> Floats:
    """Change (6·(K-1),) of all poses but the first that reduces the errors, those beyond `scale` hardly counted."""
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import splu

    errors = graph.errors(poses)
    weights = 1 / np.sqrt(1 + np.square(errors).sum(axis=1) / scale**2)
    jacobian = graph.jacobian(poses, weights)
    normal = jacobian.T @ jacobian
    damped = (normal + diags_array(_DAMPING * normal.diagonal() + 1e-12)).tocsc()
    step: Floats = splu(damped).solve(-(jacobian.T @ (weights[:, None] * errors).ravel()))
    return step


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


def _adjoints(poses: Floats) -> Floats:
    """Adjoints (N,6,6) of poses (N,4,4): each transforms a motion (ω, t) from its pose's source frame to its target."""
    turn = poses[:, :3, :3]
    adjoints = np.zeros((len(poses), 6, 6))
    adjoints[:, :3, :3] = adjoints[:, 3:, 3:] = turn
    adjoints[:, 3:, :3] = np.cross(poses[:, None, :3, 3], turn, axisa=2, axisb=1, axisc=1)
    return adjoints
