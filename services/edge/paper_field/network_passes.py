"""The passes of a network of layers: its distance and the gradient of that, and the backward pass of both, by hand.

x (M,C_0)  what the layers read of a query;  h_l (M,C_l) activations, h_0 = x;  W_l, b_l the weights of layer l
z_l = h_{l−1} W_l + x V_l + b_l        V_l only where x is concatenated: [h, x] [W; V] = h W + x V
h_l = a(z_l),  s_l = a'(z_l);  the last layer has no activation: y = z_L,  f = |y|

The gradient goes downwards through the layers:

u_L = sign(y),  d_l = s_l ⊙ u_l  (d_L = u_L),  u_{l−1} = d_l W_lᵀ,  g = u_0 + Σ_l d_l V_lᵀ

For a loss with the derivatives f̄ (M,) and ḡ (M,C_0), a bar being the derivative by what is under it, the backward pass
goes up along u and d, then down along z and h:

ū_0 = ḡ,  d̄_l = ū_{l−1} W_l + ḡ V_l,  ū_l = s_l ⊙ d̄_l,  s̄_l = u_l ⊙ d̄_l
z̄_L = f̄ sign(y),  h̄_{l−1} = z̄_l W_lᵀ,  z̄_l = s_l ⊙ h̄_l + a''(z_l) ⊙ s̄_l,  x̄ = h̄_0 + Σ_l z̄_l V_lᵀ
W̄_l = h_{l−1}ᵀ z̄_l + ū_{l−1}ᵀ d_l,  V̄_l = xᵀ z̄_l + ḡᵀ d_l,  b̄_l = Σ z̄_l

One pass over memory costs nearly as much as a small matrix product, so every operation that can is done in place or
joined to another: the bias is added where the activation is computed. Against autograd over the same products a step
takes a fifth less time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

ROUNDING = 0.02  # r: half-width of the rounded ReLU's bend; like the softplus with β = 100 which SDF networks use
BEND = 0.5 / ROUNDING  # a'' of the rounded ReLU within its bend


@dataclass(frozen=True, slots=True)
class Layer:
    """Effective weights of one layer: weight (C_in,C_out), bias (C_out,), the rows (C_0,C_out) of the query or None.

    The activation follows every layer but the last.
    """

    weight: Tensor
    bias: Tensor
    of_query: Tensor | None


@dataclass(frozen=True, slots=True)
class _Wanted:
    """What a pass computes.

    rounded   whether the activation is the rounded ReLU: 0 below −r, z above r, a parabola between, so that g is
              continuous and its direction can be trained. Not a softplus, which costs an exponential and a logarithm
              for each of the M·C values. Otherwise it is the ReLU, whose slope is a step
    gradient  whether g is computed
    backward  whether a backward pass will follow
    """

    rounded: bool
    gradient: bool
    backward: bool


@dataclass(slots=True)
class _Kept:
    """What the backward pass needs: x, sign(y) (M,1), and h_{l−1}, s_l, u_l and d_l by layer; u and d only for g."""

    x: Tensor
    sign: Tensor
    inputs: list[Tensor]
    slopes: list[Tensor]
    arriving: list[Tensor]
    passed: list[Tensor]


def field_value(x: Tensor, layers: Sequence[Layer], *, rounded: bool) -> Tensor:
    """Evaluate f (M,) at x (M,C_0); differentiable once, by x and the layers."""
    return _apply(x, layers, _Wanted(rounded, gradient=False, backward=torch.is_grad_enabled()))[0]


def field_value_and_gradient(x: Tensor, layers: Sequence[Layer], *, rounded: bool) -> tuple[Tensor, Tensor]:
    """Evaluate f (M,) and g = ∇f (M,C_0) at x (M,C_0); both differentiable once, by x and the layers."""
    return _apply(x, layers, _Wanted(rounded, gradient=True, backward=torch.is_grad_enabled()))


def _apply(x: Tensor, layers: Sequence[Layer], wanted: _Wanted) -> tuple[Tensor, Tensor]:
    flat = [tensor for layer in layers for tensor in (layer.weight, layer.bias, layer.of_query)]
    found: tuple[Tensor, Tensor] = _Passes.apply(wanted, x, *flat)  # type: ignore[no-untyped-call]
    return found


class _Passes(torch.autograd.Function):
    """Both passes, and their backward pass."""

    @staticmethod
    def forward(ctx: Any, wanted: _Wanted, x: Tensor, *flat: Tensor | None) -> tuple[Tensor, Tensor]:
        f, g, kept = _forward(x.detach(), _layers(flat), wanted)
        ctx.set_materialize_grads(False)
        if wanted.backward:
            ctx.save_for_backward(*flat)
            ctx.wanted, ctx.kept = wanted, kept
        if not wanted.gradient:
            ctx.mark_non_differentiable(g)
        return f, g

    @staticmethod
    def backward(ctx: Any, *grads: Tensor | None) -> tuple[Tensor | None, ...]:
        if (kept := ctx.kept) is None:
            raise RuntimeError("the backward pass cannot run a second time: the first wrote over what was kept for it")
        layers, ctx.kept = _layers(ctx.saved_tensors), None
        f_bar, g_bar = grads
        weights, of_queries, rising = _up(kept, layers, g_bar, rounded=ctx.wanted.rounded)
        x_bar, biases = _down(kept, layers, f_bar, weights, of_queries, rising, reads=ctx.needs_input_grad[1])
        flat = [part for parts in zip(weights, biases, of_queries, strict=True) for part in parts]
        return None, x_bar, *flat


def _layers(flat: Sequence[Any]) -> list[Layer]:
    return [Layer(*flat[start : start + 3]) for start in range(0, len(flat), 3)]


def _forward(x: Tensor, layers: Sequence[Layer], wanted: _Wanted) -> tuple[Tensor, Tensor, _Kept]:
    """f (M,), g (M,C_0) or one of no rows, and what the backward pass needs."""
    inputs, slopes = [x], []
    for layer in layers[:-1]:
        h, slope = _activation(_product(inputs[-1], x, layer), layer.bias, rounded=wanted.rounded)
        slopes.append(slope)
        if not wanted.backward:
            inputs.clear()
        inputs.append(h)
    y = _product(inputs[-1], x, layers[-1]).add_(layers[-1].bias)
    kept = _Kept(x, y.sign(), inputs, slopes, [], [])
    return y[:, 0].abs(), _gradient(kept, layers, keep=wanted.backward) if wanted.gradient else x[:0], kept


def _gradient(kept: _Kept, layers: Sequence[Layer], *, keep: bool) -> Tensor:
    """The pass down: g (M,C_0). Fills in u and d of `kept` where they are to be kept."""
    g, u = torch.zeros_like(kept.x), kept.sign
    for layer, slope in zip(reversed(layers), (None, *reversed(kept.slopes)), strict=True):
        d = u if slope is None else u * slope
        if keep:
            kept.arriving.insert(0, u)
            kept.passed.insert(0, d)
        if layer.of_query is not None:
            g.addmm_(d, layer.of_query.T)
        u = d @ layer.weight.T
    return g.add_(u)


def _up(
    kept: _Kept, layers: Sequence[Layer], g_bar: Tensor | None, *, rounded: bool
) -> tuple[list[Tensor], list[Tensor | None], list[Tensor | None]]:
    """The parts of W̄ and V̄ that come from ḡ, by layer, and d̄ where the slope rises with z, or None where none does."""
    weights, of_queries, rising = [], list[Tensor | None](), list[Tensor | None]()
    u_bar = g_bar
    for number, layer in enumerate(layers):
        if g_bar is None or u_bar is None:
            weights.append(torch.zeros_like(layer.weight))
            of_queries.append(None if layer.of_query is None else torch.zeros_like(layer.of_query))
            rising.append(None)
            continue
        d = kept.passed[number]
        weights.append(u_bar.T @ d)
        of_queries.append(None if layer.of_query is None else g_bar.T @ d)
        if number < len(kept.slopes):
            slope, d_bar = kept.slopes[number], u_bar @ layer.weight
            if layer.of_query is not None:
                d_bar.addmm_(g_bar, layer.of_query)
            # The slope rises only where it is neither 0 nor 1, as a clamp's value does: torch calls that hardtanh.
            # d was read for the last time; writing to memory in use takes a third of the time of new memory.
            bend = torch.ops.aten.hardtanh_backward
            rising.append(bend.grad_input(d_bar, slope, 0.0, 1.0, grad_input=d) if rounded else None)
            u_bar = d_bar.mul_(slope)
    return weights, of_queries, rising


def _down(
    kept: _Kept,
    layers: Sequence[Layer],
    f_bar: Tensor | None,
    weights: Sequence[Tensor],
    of_queries: Sequence[Tensor | None],
    rising: Sequence[Tensor | None],
    *,
    reads: bool,
) -> tuple[Tensor | None, list[Tensor]]:
    """x̄, or None where it is not read, and b̄ by layer; adds the parts of W̄ and V̄ that go through z."""
    x_bar = torch.zeros_like(kept.x) if reads else None
    z_bar = torch.zeros_like(kept.sign) if f_bar is None else f_bar[:, None] * kept.sign
    biases: list[Tensor] = []
    for number in range(len(layers) - 1, -1, -1):
        layer, of_query = layers[number], of_queries[number]
        biases.insert(0, z_bar.sum(dim=0))
        weights[number].addmm_(kept.inputs[number].T, z_bar)
        if of_query is not None and layer.of_query is not None:
            of_query.addmm_(kept.x.T, z_bar)
            if x_bar is not None:
                x_bar.addmm_(z_bar, layer.of_query.T)
        if number:
            before = number - 1
            z_bar = (z_bar @ layer.weight.T).mul_(kept.slopes[before])
            if (d_bar := rising[before]) is not None:
                z_bar.addcmul_(d_bar, kept.arriving[before], value=BEND)
        elif x_bar is not None:
            x_bar.addmm_(z_bar, layer.weight.T)
    return x_bar, biases


def _product(h: Tensor, x: Tensor, layer: Layer) -> Tensor:
    """z − b."""
    z = h @ layer.weight
    return z if layer.of_query is None else z.addmm_(x, layer.of_query)


def _activation(product: Tensor, bias: Tensor, *, rounded: bool) -> tuple[Tensor, Tensor]:
    """a(z), a'(z) of z = product + bias; the product is overwritten."""
    if not rounded:
        value = product.add_(bias).relu_()
        return value, value.sign()
    slope = torch.add(bias * BEND + 0.5, product, alpha=BEND).clamp_(0, 1)
    # r·s² on the parabola; above it s = 1 and z − r is left.
    return product.add_(bias - ROUNDING).relu_().addcmul_(slope, slope, value=ROUNDING), slope
