"""The two networks: a query in, its unsigned distance out, and the distance's gradient by a second sweep.

q (M,3)   queries;  h_l (M,C_l) activations, h_0 = q;  W_l, b_l the effective weights of layer l
z_l = h_{l−1} W_l + q V_l + b_l        V_l only where the input is concatenated: [h, q] [W; V] = h W + q V
h_l = a(z_l),  y = z_L,  f = |y|

The gradient goes the same way back, as plain operations:

δ_L = sign(y),  δ_{l−1} = a'(z_{l-1}) ⊙ (δ_l W_lᵀ),  g = Σ_l δ_l V_lᵀ (+ δ_1 W_1ᵀ)

so one `backward` of a loss on f and g is all a step needs. Against `autograd.grad(create_graph=True)` this takes
7–25 % less time on a CPU, and a graph capture sees nothing but matrix products.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Protocol

import torch
from torch import Tensor, nn

from services.edge.field.config import FitConfig

OUTPUT_BIAS = -0.5  # geometric initialisation (SAL, Atzmon & Lipman 2020): the field of a sphere of this radius
ROUNDING = 0.02  # half-width of the bend of the rounded ReLU: that of the softplus with β = 100 which SDF networks use


@dataclass(frozen=True, slots=True)
class Layer:
    """Effective weights of one layer: weight (C_in,C_out), bias (C_out,), and the rows (3,C_out) of the query, or None.

    A bent layer is followed by the activation.
    """

    weight: Tensor
    bias: Tensor
    of_query: Tensor | None
    bent: bool


class Activation(Protocol):
    """z (M,C) -> a(z), a'(z), both differentiable."""

    def __call__(self, z: Tensor) -> tuple[Tensor, Tensor]: ...


def relu(z: Tensor) -> tuple[Tensor, Tensor]:
    """The slope is a step: no gradient flows through it, but losses on g still reach the weights."""
    return torch.relu(z), (z > 0).to(z.dtype)


def rounded_relu(z: Tensor) -> tuple[Tensor, Tensor]:
    """0 below −r, z above r, a parabola between: g is continuous, so that its direction can be trained and trusted.

    Not a softplus, which costs an exponential and a logarithm for each of the M·C values.
    """
    out: tuple[Tensor, Tensor] = _RoundedReLU.apply(z)  # type: ignore[no-untyped-call]
    return out


class _RoundedReLU(torch.autograd.Function):
    """By hand, for autograd's own chain takes twice as many passes over the memory, a fifth of a step."""

    @staticmethod
    def forward(ctx: Any, z: Tensor) -> tuple[Tensor, Tensor]:
        slope = z.mul(0.5 / ROUNDING).add_(0.5).clamp_(0, 1)
        ctx.save_for_backward(slope)
        ctx.set_materialize_grads(False)
        # r·s² on the parabola; above it s = 1 and z − r is left.
        return torch.addcmul(torch.relu_(z - ROUNDING), slope, slope, value=ROUNDING), slope

    @staticmethod
    def backward(ctx: Any, *grads: Tensor | None) -> Tensor | None:
        (slope,) = ctx.saved_tensors
        to_value, to_slope = grads
        if to_slope is None:
            return None if to_value is None else to_value * slope
        # The slope rises only where it is neither 0 nor 1: the rule of a clamp, which torch calls hardtanh.
        rising = torch.ops.aten.hardtanh_backward(to_slope, slope, 0.0, 1.0)
        through: Tensor = rising.mul_(0.5 / ROUNDING)
        return through if to_value is None else through.addcmul_(to_value, slope)


class FieldNetwork(nn.Module):
    """What both networks share: the sweeps at the head of this file."""

    activation: Activation = staticmethod(relu)

    def layers(self) -> Sequence[Layer]:
        """The effective weights, from the parameters as they stand."""
        raise NotImplementedError

    def forward(self, q: Tensor) -> Tensor:
        """q (M,3) in the unit frame -> f (M,) ≥ 0."""
        h = q
        for layer in self.layers():
            z = _affine(h, q, layer)
            h = self.activation(z)[0] if layer.bent else z
        return h[:, 0].abs()

    def value_and_gradient(self, q: Tensor) -> tuple[Tensor, Tensor]:
        """q (M,3) -> f (M,) and g = ∇f (M,3), both differentiable in the parameters and in q."""
        layers, slopes = self.layers(), []
        h = q
        for layer in layers:
            h = _affine(h, q, layer)
            slope = None
            if layer.bent:
                h, slope = self.activation(h)
            slopes.append(slope)
        y = h
        back, g = y.sign(), torch.zeros_like(q)
        for layer, slope in zip(reversed(layers), reversed(slopes), strict=True):
            if slope is not None:
                back = back * slope
            if layer.of_query is not None:
                g = g + back @ layer.of_query.T
            back = back @ layer.weight.T
        return y[:, 0].abs(), g + back


def _affine(h: Tensor, q: Tensor, layer: Layer) -> Tensor:
    z = torch.addmm(layer.bias, h, layer.weight)
    return z if layer.of_query is None else torch.addmm(z, q, layer.of_query)


class SeparableNetwork(FieldNetwork):
    """The paper's network: six 1-D depthwise-separable convolutions, the input concatenated at the 2nd and the 5th.

    The reading: a block is a depthwise convolution (a filter per channel), then a pointwise one (a matrix over the
    channels), then the activation, and nothing between the two (F. Chollet, "Xception", CVPR 2017, found it harmful).
    The "time" axis of the convolution is the batch, and queries of a batch are no neighbours; the kernel size is 1, for
    a query's value must not depend on which other queries share its batch. The depthwise convolution is then a scale
    and a shift of every channel, which is folded into the matrix before the queries see it: what the six blocks cost is
    six matrix products. A linear layer reads the distance off the last block.

    128 channels take 85,000 parameters. With 256 the matrices alone would take 330,000, above the paper's 147,200; they
    then pass through a linear bottleneck (M. Sandler et al., "MobileNetV2", CVPR 2018), as its own block does.
    """

    BLOCKS = 6
    CONCATENATED = (2, 5)  # counted from 1
    BOTTLENECK = 48  # channels, for the matrices of 256: the most that keeps 147,200 is 51
    UNBROKEN = 128  # channels up to which a block has a matrix of its own

    def __init__(self, width: int, generator: torch.Generator) -> None:
        super().__init__()
        self.activation = rounded_relu
        rank = self.BOTTLENECK if width > self.UNBROKEN else None
        self.blocks = nn.ModuleList(
            _Separable(3 if number == 1 else width, width, number in self.CONCATENATED, rank, generator)
            for number in range(1, self.BLOCKS + 1)
        )
        self.out_weight = nn.Parameter(_mean_weight(width, 1, generator))
        self.out_bias = nn.Parameter(torch.zeros(1))
        self._become_sphere(generator)

    @torch.no_grad()
    def _become_sphere(self, generator: torch.Generator) -> None:
        """The geometric initialisation holds on average over many channels; a bottleneck of 48 is off by a half."""
        q = torch.nn.functional.normalize(torch.randn(512, 3, generator=generator)) * -OUTPUT_BIAS
        self.out_weight.mul_(-OUTPUT_BIAS / self.forward(q).mean())
        self.out_bias.fill_(OUTPUT_BIAS)

    def layers(self) -> Sequence[Layer]:
        folded = [layer for block in self.blocks if isinstance(block, _Separable) for layer in block.layers()]
        return [*folded, Layer(self.out_weight, self.out_bias, None, bent=False)]


class _Separable(nn.Module):
    """One block: depthwise scale and shift (C_in,), pointwise matrix (C_in,C_out), or two through a bottleneck."""

    def __init__(
        self, channels: int, width: int, concatenated: bool, rank: int | None, generator: torch.Generator
    ) -> None:
        super().__init__()
        self.channels = channels
        self.concatenated = concatenated
        inputs = channels + 3 * concatenated
        self.scale = nn.Parameter(torch.ones(inputs))
        self.shift = nn.Parameter(torch.zeros(inputs))
        pointwise = _spread_weight(inputs, width, generator)
        if concatenated:
            pointwise[channels:] = 0  # as in the geometric initialisation: the input says nothing new yet
        self.narrow: nn.Parameter | None = None
        if rank is not None and channels > rank:
            # A random projection and its transpose keep the activations' variance and so the geometric start.
            self.narrow = nn.Parameter(_orthogonal(inputs, rank, generator) * math.sqrt(inputs / rank))
            pointwise = _spread_weight(rank, width, generator)
        self.weight = nn.Parameter(pointwise)
        self.bias = nn.Parameter(torch.zeros(width))

    def layers(self) -> list[Layer]:
        first = self.weight if self.narrow is None else self.narrow
        folded, shifted = self.scale[:, None] * first, self.shift @ first
        of_query = folded[self.channels :] if self.concatenated else None
        if self.narrow is None:
            return [Layer(folded[: self.channels], self.bias + shifted, of_query, bent=True)]
        return [
            Layer(folded[: self.channels], shifted, of_query, bent=False),
            Layer(self.weight, self.bias, None, bent=True),
        ]


class AncestorsNetwork(FieldNetwork):
    """The MLP of NeuralPull, CAP-UDF and LevelSetUDF: 8 hidden layers of 256, ReLU, weight norm, 463,100 parameters.

    The input is concatenated at the fourth hidden layer's output, divided by √2; the layer before makes 253 channels,
    so that 256 remain. Geometric initialisation.
    """

    HIDDEN = 8
    WIDTH = 256
    CONCATENATED = 4  # counted from 0: the layer that reads [h, q]

    def __init__(self, generator: torch.Generator) -> None:
        super().__init__()
        ends = [3, *[self.WIDTH] * self.HIDDEN, 1]
        self.directions, self.lengths, self.biases = nn.ParameterList(), nn.ParameterList(), nn.ParameterList()
        for number, (inputs, outputs) in enumerate(pairwise(ends)):
            outputs -= 3 * (number + 1 == self.CONCATENATED)
            last = number == self.HIDDEN
            weight = (_mean_weight if last else _spread_weight)(inputs, outputs, generator)
            self.directions.append(nn.Parameter(weight))
            self.lengths.append(nn.Parameter(weight.norm(dim=0)))
            self.biases.append(nn.Parameter(torch.full((outputs,), OUTPUT_BIAS if last else 0.0)))

    def layers(self) -> Sequence[Layer]:
        made = []
        parts = zip(self.directions, self.lengths, self.biases, strict=True)
        for number, (direction, length, bias) in enumerate(parts):
            weight = direction * (length / direction.norm(dim=0))
            of_query = None
            if number == self.CONCATENATED:
                weight = weight / math.sqrt(2)
                weight, of_query = weight[:-3], weight[-3:]
            made.append(Layer(weight, bias, of_query, bent=number < self.HIDDEN))
        return made


def network_of(config: FitConfig) -> FieldNetwork:
    """The configured network with its first weights, on the CPU; the same for the same seed whatever else runs."""
    generator = torch.Generator().manual_seed(config.seed)
    if config.model == "mlp":
        return AncestorsNetwork(generator)
    return SeparableNetwork(config.width, generator)


def _spread_weight(inputs: int, outputs: int, generator: torch.Generator) -> Tensor:
    """Geometric initialisation of a hidden layer: N(0, 2/C_out), which keeps |h| under a ReLU."""
    return torch.randn(inputs, outputs, generator=generator) * math.sqrt(2 / outputs)


def _mean_weight(inputs: int, outputs: int, generator: torch.Generator) -> Tensor:
    """Geometric initialisation of the last layer: the mean of the channels, so that y ≈ |q| + the output bias."""
    return math.sqrt(math.pi / inputs) + 1e-4 * torch.randn(inputs, outputs, generator=generator)


def _orthogonal(inputs: int, outputs: int, generator: torch.Generator) -> Tensor:
    """Orthonormal columns (C_in,C_out)."""
    columns: Tensor = torch.linalg.qr(torch.randn(inputs, outputs, generator=generator))[0]
    return columns
