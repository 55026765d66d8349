"""The losses of trained anchors: neighbouring patches agree, and where there is noise they stay near their points.

i, j         two anchors that are neighbours, m the middle between them; h_ij = √(h_i h_j), s_ij = sign(n_i·n_j)
d_i, g_i     signed distance and gradient of the patch of i (`anchors.py`); o_i its offset
ρ_c(r²)      = c² log(1 + r²/c²): a crease or another layer pulls no harder than c

    L_d = Σ w_ij ρ_c((d_i(m) − s_ij d_j(m))²/h_ij²) / N       strong and weak evaluation of (6): two predictions of one
    L_g = Σ w_ij ρ_k(1 − (g_i(m)·g_j(m))²) / N                place, made from different points, agree; so do gradients
    L_p = mean μ_i (o_i − z_i)²/σ_i²                          the surface term (4); z_i: the scanned point over the base
    L_c = mean (c₁² + c₂² + c₃²)                              keeps patches with few neighbours near their base

    w_ij = exp(−(0.6 |x_j−x_i|/h_ij)²) · exp(−(offset across the mean plane / layer h_ij)²) · |n_i·n_j|^p

Patches are compared at the middle, not at the neighbour's own point: third-order terms, which no patch can follow,
cancel there, and the field blends patches half-way. At the neighbour's point the error on a sparse pleated skirt is a
third larger.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from capture2vr.edge.arrays import Floats, Ints
from capture2vr.edge.field.anchors import Anchors, base, surface_at
from capture2vr.edge.field.compute import rows
from capture2vr.edge.field.quadrics import TINY

NEIGHBOURS = 20  # per anchor: with 10 the error on a dress is 4 % larger, with 24 it is the same
NEAR = 0.6  # per spacing: how fast a neighbour's weight falls with its distance
DISTANCE = 1.0  # weight of L_d
GRADIENT = (
    0.2  # weight of L_g: at 0.05 and 0.5 the error on a dress is 4 % larger; at 0 on sparse pleats twice as large
)
FLATNESS = (
    1e-3  # weight of L_c: at 1e-2 errors on sparse pleats grow by a third, at 1e-4 on two sparse sheets by a fifth
)
LEAST = 1e-3  # least weight of an edge: lighter ones cost time and change nothing


@dataclass(frozen=True, slots=True)
class Tolerance:
    """How far two neighbouring patches may differ and still count as one smooth sheet.

    layer      offset across, in spacings, above which a neighbour is another layer's;  alignment: power p of |n_i·n_j|
    kink       sine of the angle between two gradients above which there is a crease; distances use a quarter of it, in
               spacings
    """

    layer: float
    alignment: int
    kink: float

    @property
    def step(self) -> float:
        """c of ρ_c for distances: across half a spacing a kink moves the surface by a quarter of its sine."""
        return self.kink / 4


LOOSE = Tolerance(layer=1.5, alignment=1, kink=0.3)  # for the trials, whose flat patches bend only as they train
TIGHT = Tolerance(layer=0.6, alignment=2, kink=0.2)  # for the rest: the local field's normals are good


@dataclass(frozen=True, slots=True)
class AnchorEdges:
    """E pairs of neighbouring anchors, and what the losses need of each pair.

    first, second                (E,) indices of the two anchors
    middle_first, middle_second  (E,3) the middle in the frame of each anchor, in its spacings
    turn                         (E,3,3) the second's frame in the first's
    scale_first, scale_second    (E,) spacing over h_ij, the second's with the sign s_ij
    weight                       (E,) w_ij, whose sum is N
    base_first, base_second      (E,3) height and slopes of each base at the middle
    """

    first: Tensor
    second: Tensor
    middle_first: Tensor
    middle_second: Tensor
    turn: Tensor
    scale_first: Tensor
    scale_second: Tensor
    weight: Tensor
    base_first: Tensor
    base_second: Tensor

    def parts(self, size: int) -> list[AnchorEdges]:
        """Split the edges into parts of at most `size`."""
        pieces = zip(*(getattr(self, name).split(size) for name in self.__slots__), strict=True)
        return [AnchorEdges(*piece) for piece in pieces]


def edges_between(anchors: Anchors, neighbours: Ints, tolerance: Tolerance, device: torch.device) -> AnchorEdges:
    """Build the edges between anchors and those of their neighbours (N,K), self first, on the same sheet."""
    count = len(anchors.xyz)
    own = np.repeat(np.arange(count), neighbours.shape[1] - 1)
    other = neighbours[:, 1:].ravel()
    # Not `np.unique`, whose hashing takes fifteen times as long as a sort.
    pairs = np.sort(np.minimum(own, other) * count + np.maximum(own, other))
    pairs = pairs[np.diff(pairs, prepend=-1) > 0]
    i, j = pairs // count, pairs % count
    i, j = i[i != j], j[i != j]  # the first neighbour of a duplicate point may be its copy
    xyz, normals = surface_at(anchors)
    between = np.sqrt(anchors.spacing[i] * anchors.spacing[j])
    weight = _weights(xyz[j] - xyz[i], normals[i], normals[j], between, tolerance)
    i, j, weight = i[weight > LEAST], j[weight > LEAST], weight[weight > LEAST]
    weight *= count / (weight.sum() + TINY)
    spacing = np.sqrt(anchors.spacing[i] * anchors.spacing[j])
    half = (anchors.xyz[j] - anchors.xyz[i])[..., None] / 2
    sign = np.where(_dot(normals[i], normals[j]) < 0, -1, 1)
    middle_i = np.matmul(anchors.frame[i], half)[..., 0] / anchors.spacing[i, None]
    middle_j = -np.matmul(anchors.frame[j], half)[..., 0] / anchors.spacing[j, None]

    def tensor(array: Floats) -> Tensor:
        return torch.as_tensor(np.ascontiguousarray(array, np.float32), device=device)

    return AnchorEdges(
        torch.as_tensor(i, device=device),
        torch.as_tensor(j, device=device),
        tensor(middle_i),
        tensor(middle_j),
        tensor(np.matmul(anchors.frame[i], anchors.frame[j].transpose(0, 2, 1))),
        tensor(anchors.spacing[i] / spacing),
        tensor(sign * anchors.spacing[j] / spacing),
        tensor(weight),
        tensor(np.stack(base(anchors.terms[i], middle_i[:, :2]), axis=1)),
        tensor(np.stack(base(anchors.terms[j], middle_j[:, :2]), axis=1)),
    )


def _weights(apart: Floats, normals_i: Floats, normals_j: Floats, spacing: Floats, tolerance: Tolerance) -> Floats:
    """Weights w_ij (E,) of edges.

    Offsets are taken across the mean of both planes: on a round sheet a neighbour lies in it, but in neither own plane.
    """
    cos = _dot(normals_i, normals_j)
    mean = normals_i + np.where(cos < 0, -1, 1)[:, None] * normals_j
    across = _dot(apart, mean) / (np.linalg.norm(mean, axis=1) + TINY)
    near = NEAR * np.linalg.norm(apart, axis=1) / spacing
    weight = np.exp(-np.square(near) - np.square(across / (tolerance.layer * spacing)))
    aligned: Floats = weight * np.abs(cos) ** tolerance.alignment
    return aligned


def agreement_losses(shape: Tensor, edges: AnchorEdges, tolerance: Tolerance) -> tuple[Tensor, Tensor]:
    """L_d and L_g of the shapes (N,6), summed over these edges."""
    distance_i, gradient_i = _evaluate(rows(shape, edges.first), edges.middle_first, edges.base_first)
    distance_j, gradient_j = _evaluate(rows(shape, edges.second), edges.middle_second, edges.base_second)
    apart = distance_i * edges.scale_first - distance_j * edges.scale_second
    cos = (gradient_i * torch.einsum("eab,eb->ea", edges.turn, gradient_j)).sum(1)
    distance = (edges.weight * _robust(apart.square(), tolerance.step)).sum() / len(shape)
    gradient = (edges.weight * _robust(1 - cos.square(), tolerance.kink)).sum() / len(shape)
    return distance, gradient


def surface_loss(offset: Tensor, height: Tensor, trust: Tensor) -> Tensor:
    """L_p, the pull to the scanned points; trust (N,) = μ_i/σ_i², in spacings like the offset and the height."""
    return (trust * (offset - height).square()).mean()


def flatness_loss(shape: Tensor) -> Tensor:
    """L_c, the mean squared curvature."""
    return shape[:, 3:].square().mean()


def _evaluate(shape: Tensor, place: Tensor, base_there: Tensor) -> tuple[Tensor, Tensor]:
    """Signed distance (E,) in spacings and unit gradient (E,3) of a patch at a place (E,3), in the patch's frame."""
    o, a, b, c1, c2, c3 = shape.unbind(1)
    x, y, z = place.unbind(1)
    slope_x, slope_y = a + c1 * x + c2 * y, b + c2 * x + c3 * y
    height = base_there[:, 0] + o + (a + slope_x) * x / 2 + (b + slope_y) * y / 2
    slope_x, slope_y = slope_x + base_there[:, 1], slope_y + base_there[:, 2]
    up = torch.rsqrt(1 + slope_x.square() + slope_y.square())
    return (z - height) * up, torch.stack([-slope_x * up, -slope_y * up, up], dim=1)


def _robust(square: Tensor, cut: float) -> Tensor:
    """ρ_c of squared residuals, with c = `cut`."""
    return cut * cut * torch.log1p(square / (cut * cut))


def _dot(a: Floats, b: Floats) -> Floats:
    dot: Floats = np.einsum("ex,ex->e", a, b)
    return dot
