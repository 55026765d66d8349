"""The losses of the paper, one function per equation. Torch in, torch out; every mean runs over the batch.

P (N,3)    the points;  q (M,3) queries, q_s strong and q_w weak ones of a pair;  p(q) the nearest point to q
f, g       the field and its gradient;  ĝ = g/|g|
q̂          the pulled query q − f(q)·ĝ(q)
ω          a moving average of a pair's weak distance

(1)  L_CD   = mean |q̂ − p(q̂)| + mean |p − q̂(p)|
(2)  L_proj = mean exp(±λ f(q)) · (1 − |cos(g(q), g(q̂))|)  +  L_surf
(3)  L_orth = mean ( 1 − |cos(g(q), q − p(q))| )
(4)  L_surf = mean f(p)
(5)  ω      ← β ω + (1−β) f(q_w)
(6)  L_sc   = mean ‖ log(1/ω)·(f(q_s) ĝ(q_s) − f(q_w) ĝ(q_w)) + ξ ‖₂
(7)  L      = L_CD + τ_p L_proj + τ_o L_orth + τ_s L_sc

The paper prints sums where means stand here: every one of them over the M queries of a batch, or over as many points.
So all terms are divided by the same number, which leaves their ratios as they are printed, and to which Adam is blind.
What else is read into the equations is told in docs/method.md, equation by equation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import Tensor

TINY = 1e-8  # unit frame, below float32's resolution there: keeps the derivative of √ finite at 0
XI = 1e-8  # ξ of (6): the paper's, which keeps the derivative of |·| defined where a pair agrees
MOST_CERTAIN = math.log(1e4)  # bound of log(1/ω): ω is a ten-thousandth of the unit frame, a tenth of any spacing


def pull_vector(distance: Tensor, gradient: Tensor) -> Tensor:
    """Vectors (M,3) from the surface to the queries, f(q)·ĝ(q). They pass through 0 where the gradient turns round."""
    return distance[:, None] * gradient / _length(gradient)[:, None]


def pull(q: Tensor, distance: Tensor, gradient: Tensor) -> Tensor:
    """Move the queries to where the field says the surface is: q̂ (M,3)."""
    return q - pull_vector(distance, gradient)


def chamfer_loss(pulled: Tensor, nearest_point: Tensor, point: Tensor, nearest_pulled: Tensor) -> Tensor:  # eq. 1
    """Chamfer distance, both directions added, not squared: q̂ (M,3), the nearest point to each; points (K,3), the
    nearest q̂."""
    return _length(pulled - nearest_point).mean() + _length(point - nearest_pulled).mean()


def projection_loss(distance: Tensor, gradient: Tensor, gradient_at_pull: Tensor, *, growth: float) -> Tensor:  # eq. 2
    """Penalise level sets that are not parallel to the surface: gradients that turn along the pull.

    growth: λ with its sign; below 0, queries near the surface weigh most. The second sum in (2) is `surface_loss`.
    """
    return (torch.exp(growth * distance) * (1 - _abs_cos(gradient, gradient_at_pull))).mean()


def orthogonality_loss(gradient: Tensor, q: Tensor, nearest_point: Tensor) -> Tensor:  # eq. 3
    """Penalise gradients that point neither away from the nearest point nor at it. In [0,1]."""
    return (1 - _abs_cos(gradient, q - nearest_point)).mean()


def surface_loss(distance_at_points: Tensor) -> Tensor:  # eq. 4
    """Mean distance at the points, where the surface should lie."""
    return distance_at_points.mean()


def update_memory(memory: Tensor, weak_distance: Tensor, *, keep: float) -> Tensor:  # eq. 5
    """Update the moving average ω (M,); where it is NaN, it starts at the first prediction. No gradient flows."""
    weak = weak_distance.detach()
    return torch.where(memory.isnan(), weak, keep * memory + (1 - keep) * weak)


def certainty(memory: Tensor) -> Tensor:
    """log(1/ω) of (6), (M,) from 0 to `MOST_CERTAIN`; 0 where ω is NaN: nothing has been predicted."""
    bounded = -torch.log(memory.detach().clamp(min=math.exp(-MOST_CERTAIN), max=1))
    return torch.where(memory.isnan(), torch.zeros_like(bounded), bounded)


def self_consistency_loss(strong: Tensor, weak: Tensor, weight: Tensor | None) -> Tensor:  # eq. 6
    """Penalise pairs whose two predictions (M,C) differ, times `weight` (M,) or 1.

    C = 3 for `pull_vector`s, whose norm is that of a vector; C = 1 for distances.
    """
    difference = strong - weak
    if weight is not None:
        difference = weight[:, None] * difference
    norm: Tensor = torch.linalg.vector_norm(difference + XI, dim=1)
    return norm.mean()


def far_loss(distance: Tensor, nearest_distance: Tensor) -> Tensor:
    """Mean difference of the field, at far queries, from the distance to the nearest point.

    Not in the paper: it keeps false sheets out.
    """
    return (distance - nearest_distance).abs().mean()


def regression_loss(distance: Tensor, target: Tensor) -> Tensor:
    """Mean difference of the field from the target distances: the loss of the warm start."""
    return (distance - target).abs().mean()


def total_loss(terms: Mapping[str, Tensor], weights: Mapping[str, float]) -> Tensor:  # eq. 7
    """Weighted sum Σ τ · term over the named terms."""
    return torch.stack([weights[name] * term for name, term in terms.items()]).sum()


def _length(vectors: Tensor) -> Tensor:
    return torch.sqrt(vectors.square().sum(dim=1) + TINY * TINY)


def _abs_cos(a: Tensor, b: Tensor) -> Tensor:
    return ((a * b).sum(dim=1) / (_length(a) * _length(b))).abs()
