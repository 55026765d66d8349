"""The losses that heads are trained with, and the metrics of points. Torch in, torch out.

P (n,p,3) predicted points;  T (n,t,3) points on the surface;  d(a,B) distance from a to the nearest of B

(1)  CD  = mean d(p,T)² + mean d(t,P)²                      Chamfer distance: squared, both ways added
(2)  L   = CD + c·(mean d(p,T) + mean d(t,P))               the second part moves points that are nearly right
(3)  F@r = 2·a·b / (a + b),  a = share of d(p,T) < r,  b = share of d(t,P) < r
(4)  L_udf = mean |min(f,δ) − min(d,δ)| + w · mean (1 − cos(∇f, ∇d))          the second where d < δ
"""

from __future__ import annotations

import torch
from torch import Tensor

NEAR = 0.05  # r of (3), for things whose farthest point is at 1
LINEAR = 0.1  # c of (2): both parts pull equally at a distance of 0.05, where F is decided
CLAMP = 0.2  # δ of (4), from AnchorUDF
DIRECTION = 0.02  # w of (4), from AnchorUDF


def nearest(a: Tensor, b: Tensor) -> tuple[Tensor, Tensor]:
    """Nearest neighbours of a (n,p,3) in b (n,t,3), and of b in a: indices (n,p) and (n,t). No gradient."""
    with torch.no_grad():
        return _nearest(a, b)


def gaps(a: Tensor, b: Tensor) -> tuple[Tensor, Tensor]:
    """Squared distances d(a,B)² (n,p) and d(b,A)² (n,t); gradients flow."""
    to_b, to_a = nearest(a, b)
    return _squared(a - _gather(b, to_b)), _squared(b - _gather(a, to_a))


def chamfer(a: Tensor, b: Tensor) -> Tensor:  # eq. 1
    """Chamfer distance (n,) of a (n,p,3) and b (n,t,3)."""
    there, back = gaps(a, b)
    return there.mean(dim=1) + back.mean(dim=1)


def chamfer_loss(points: Tensor, surface: Tensor) -> Tensor:  # eq. 2
    """Loss of points (n,p,3) against points (n,t,3) of the surface, over the whole batch."""
    there, back = gaps(points, surface)
    straight = (there + 1e-6).sqrt().mean() + (back + 1e-6).sqrt().mean()  # 1e-6: a bounded slope at a hit
    return there.mean() + back.mean() + LINEAR * straight


def f_score(a: Tensor, b: Tensor, near: float = NEAR) -> Tensor:  # eq. 3
    """F-score (n,) of a (n,p,3) and b (n,t,3) at the distance `near`."""
    there, back = gaps(a, b)
    hits, found = (there < near * near).float().mean(dim=1), (back < near * near).float().mean(dim=1)
    return 2 * hits * found / (hits + found).clamp(min=1e-9)


def udf_loss(distance: Tensor, gradient: Tensor, true_distance: Tensor, true_direction: Tensor) -> Tensor:  # eq. 4
    """Loss of distances (n,q) and gradients (n,q,3). True directions are unit vectors away from the surface."""
    clamped = (distance.clamp(max=CLAMP) - true_distance.clamp(max=CLAMP)).abs().mean()
    within = (true_distance < CLAMP).float()
    turned = 1 - torch.cosine_similarity(gradient, true_direction, dim=2)
    return clamped + DIRECTION * (turned * within).sum() / within.sum().clamp(min=1)


def _nearest(a: Tensor, b: Tensor) -> tuple[Tensor, Tensor]:
    """Nearest neighbours both ways, from |a|² − 2ab + |b|² as one matrix product per shape, whose table fits the cache.

    Non-negative floats are ordered like their bits: with the index in the low bits, a minimum, which is eighteen times
    as fast as an argmin, finds distance and index. The distance loses a relative precision of 2⁻¹³.
    """
    p, t = a.shape[1], b.shape[1]
    low = (1 << (max(p, t) - 1).bit_length()) - 1
    one = torch.ones_like
    a4 = torch.cat([a, a.square().sum(dim=2, keepdim=True), one(a[..., :1])], dim=2)
    b4 = torch.cat([-2 * b, one(b[..., :1]), b.square().sum(dim=2, keepdim=True)], dim=2).transpose(1, 2)
    column = torch.arange(t, dtype=torch.int32, device=a.device)[None]
    row = torch.arange(p, dtype=torch.int32, device=a.device)[:, None]
    table = a.new_empty(p, t)
    bits, keys = table.view(torch.int32), torch.empty(p, t, dtype=torch.int32, device=a.device)
    there, back = (
        torch.empty(len(a), p, dtype=torch.int32, device=a.device),
        torch.empty(len(a), t, dtype=torch.int32, device=a.device),
    )
    for number in range(len(a)):
        torch.mm(a4[number], b4[number], out=table)
        table.clamp_(min=0)
        bits.bitwise_and_(~low)
        torch.amin(torch.bitwise_or(bits, column, out=keys), 1, out=there[number])
        torch.amin(torch.bitwise_or(bits, row, out=keys), 0, out=back[number])
    return (there & low).long(), (back & low).long()


def _gather(xyz: Tensor, index: Tensor) -> Tensor:
    return xyz.gather(1, index[..., None].expand(-1, -1, 3))


def _squared(vectors: Tensor) -> Tensor:
    return vectors.square().sum(dim=2)
