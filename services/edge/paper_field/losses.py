"""The losses: one function, one equation. Torch in, torch out; every mean runs over the batch.

P (N,3)    the points;  q (M,3) queries, q_s strong and q_w weak ones of a pair;  p(q) the nearest point to q
f, g       the field and its gradient;  ĝ = g/|g|
q̂          the pulled query q − f(q)·ĝ(q)
ω          the memory of a pair's weak distance

(1)  L_CD   = ½ ( mean |q̂ − p(q̂)| + mean |p − q̂(p)| )
(2)  L_proj = mean exp(−λ f(q)) · (1 − |cos(g(q), g(q̂))|)
(3)  L_orth = mean ( 1 − |cos(g(q), q − p(q))| )
(4)  L_surf = mean f(p)
(5)  ω      ← β ω + (1−β) f(q_w)
(6)  L_sc   = mean | log(1/ω)·(f(q_s) − f(q_w)) + ξ |
(7)  L      = L_CD + τ_p L_proj + τ_o L_orth + τ_s L_sc + τ_f L_surf

λ enters with a minus sign: the paper prints a growing weight, but its source of the term (LevelSetUDF) decays with the
distance, and a growing weight would favour the far field.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import Tensor

TINY = 1e-8  # unit frame; a length below float32's resolution there: the derivative of √ stays finite at 0
XI = 1e-8  # ξ of (6): the paper's, which keeps the derivative of |·| defined where a pair agrees
MOST_CERTAIN = math.log(1e4)  # log(1/ω) ends at a ten-thousandth of the unit frame, a tenth of any point spacing


def pulled(q: Tensor, distance: Tensor, gradient: Tensor) -> Tensor:
    """q̂ (M,3): the queries moved to where the field says the surface is."""
    return q - distance[:, None] * gradient / _length(gradient)[:, None]


def chamfer_loss(pulled: Tensor, nearest_point: Tensor, point: Tensor, nearest_pulled: Tensor) -> Tensor:  # eq. 1
    """q̂ (M,3) and the nearest point to each; points (K,3) and the nearest q̂ to each: symmetric, not squared."""
    return 0.5 * (_length(pulled - nearest_point).mean() + _length(point - nearest_pulled).mean())


def projection_loss(distance: Tensor, gradient: Tensor, gradient_at_pull: Tensor, *, decay: float) -> Tensor:  # eq. 2
    """The level sets are parallel to the surface: the gradient keeps its line along the pull. In [0,1].

    The surface term that the paper adds in this equation is (4), with a weight of its own.
    """
    return (torch.exp(-decay * distance) * (1 - _abs_cos(gradient, gradient_at_pull))).mean()


def orthogonality_loss(gradient: Tensor, q: Tensor, nearest_point: Tensor) -> Tensor:  # eq. 3
    """The gradient points away from the nearest point, or at it. In [0,1]."""
    return (1 - _abs_cos(gradient, q - nearest_point)).mean()


def surface_loss(distance_at_points: Tensor) -> Tensor:  # eq. 4
    """Points lie on the surface."""
    return distance_at_points.mean()


def update_memory(memory: Tensor, weak_distance: Tensor, *, keep: float) -> Tensor:  # eq. 5
    """ω (M,) after this step; NaN, a pair never seen, starts at its first prediction. No gradient flows."""
    weak = weak_distance.detach()
    return torch.where(memory.isnan(), weak, keep * memory + (1 - keep) * weak)


def self_consistency_loss(strong_distance: Tensor, weak_distance: Tensor, memory: Tensor) -> Tensor:  # eq. 6
    """Both queries of a pair lie at one distance; pairs near the surface weigh most, up to `MOST_CERTAIN`."""
    certainty = -torch.log(memory.clamp(min=math.exp(-MOST_CERTAIN), max=1))
    return (certainty * (strong_distance - weak_distance) + XI).abs().mean()


def far_loss(distance: Tensor, nearest_distance: Tensor) -> Tensor:
    """Far from the points the field is the distance to the nearest: not the paper's, it keeps far sheets out."""
    return (distance - nearest_distance).abs().mean()


def regression_loss(distance: Tensor, target: Tensor) -> Tensor:
    """The warm start: the field is that of the planes."""
    return (distance - target).abs().mean()


def total_loss(terms: Mapping[str, Tensor], weights: Mapping[str, float]) -> Tensor:  # eq. 7
    """Σ τ · term over the named terms."""
    return torch.stack([weights[name] * term for name, term in terms.items()]).sum()


def _length(vectors: Tensor) -> Tensor:
    return torch.sqrt(vectors.square().sum(dim=1) + TINY * TINY)


def _abs_cos(a: Tensor, b: Tensor) -> Tensor:
    return ((a * b).sum(dim=1) / (_length(a) * _length(b))).abs()
