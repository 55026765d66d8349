"""The two networks: they map a query to its unsigned distance, and by a second pass to the distance's gradient.

q (M,3)   queries;  h_l (M,C_l) activations, h_0 = q;  W_l, b_l the effective weights of layer l
z_l = h_{l−1} W_l + q V_l + b_l        V_l only where the input is concatenated: [h, q] [W; V] = h W + q V
h_l = a(z_l),  y = z_L,  f = |y|

The gradient is computed backwards through the layers, with ordinary operations:

δ_L = sign(y),  δ_{l−1} = a'(z_{l-1}) ⊙ (δ_l W_lᵀ),  g = Σ_l δ_l V_lᵀ (+ δ_1 W_1ᵀ)

so one `backward` of a loss on f and g is all that a step needs. Against `autograd.grad(create_graph=True)` this takes
7–25 % less time on a CPU, and the capture of a CUDA graph meets only matrix products.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Protocol

import torch
from torch import Tensor, nn

from services.edge.paper_field.network_config import NetworkConfig

OUTPUT_BIAS = -0.5  # geometric initialisation (SAL, Atzmon & Lipman 2020): the field of a sphere of this radius
ROUNDING = 0.02  # r: half-width of the rounded ReLU's bend; like the softplus with β = 100 which SDF networks use


@dataclass(frozen=True, slots=True)
class Layer:
    """Effective weights of one layer: weight (C_in,C_out), bias (C_out,), and the rows (3,C_out) of the query, or None.

    has_activation: whether the activation follows.
    """

    weight: Tensor
    bias: Tensor
    of_query: Tensor | None
    has_activation: bool


class Activation(Protocol):
    """z (M,C) -> a(z), a'(z), both differentiable."""

    def __call__(self, z: Tensor) -> tuple[Tensor, Tensor]: ...


def relu(z: Tensor) -> tuple[Tensor, Tensor]:
    """ReLU and its slope, a step: no gradient flows through it, but losses on g still reach the weights."""
    return torch.relu(z), (z > 0).to(z.dtype)


def rounded_relu(z: Tensor) -> tuple[Tensor, Tensor]:
    """Rounded ReLU: 0 below −r, z above r, a parabola between. g is continuous, so its direction can be trained.

    Not a softplus, which costs an exponential and a logarithm for each of the M·C values.
    """
    out: tuple[Tensor, Tensor] = _RoundedReLU.apply(z)  # type: ignore[no-untyped-call]
    return out


class _RoundedReLU(torch.autograd.Function):
    """The rounded ReLU with its backward by hand: autograd's takes twice the passes over memory, a fifth of a step."""

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
    """Base class of both networks: the two passes at the head of this file."""

    activation: Activation = staticmethod(relu)

    def layers(self) -> Sequence[Layer]:
        """Compute the effective weights of all layers from the current parameters."""
        raise NotImplementedError

    def forward(self, q: Tensor) -> Tensor:
        """q (M,3) in the unit frame -> f (M,) ≥ 0."""
        h = q
        for layer in self.layers():
            z = _affine(h, q, layer)
            h = self.activation(z)[0] if layer.has_activation else z
        return h[:, 0].abs()

    def value_and_gradient(self, q: Tensor) -> tuple[Tensor, Tensor]:
        """q (M,3) -> f (M,) and g = ∇f (M,3), both differentiable in the parameters and in q."""
        layers, slopes = self.layers(), []
        h = q
        for layer in layers:
            h = _affine(h, q, layer)
            slope = None
            if layer.has_activation:
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

    As read here, a block is a depthwise convolution (a filter per channel), then a pointwise one (a matrix over the
    channels), then the activation, and nothing between the two (F. Chollet, "Xception", CVPR 2017, found it harmful).
    The "time" axis of the convolution is the batch, whose queries are no neighbours, so the kernel size is 1: a query's
    value must not depend on the other queries of its batch. The depthwise convolution is then a scale and a shift of
    every channel, which are folded into the matrix beforehand, so that six blocks cost six matrix products. A linear
    layer computes the distance from the last block.

    128 channels take 85,000 parameters. With 256 the matrices alone would take 330,000, above the paper's 147,200; they
    then pass through a linear bottleneck (M. Sandler et al., "MobileNetV2", CVPR 2018), as its own block does.
    """

    BLOCKS = 6
    CONCATENATED = (2, 5)  # counted from 1
    BOTTLENECK = 48  # channels, for the matrices of 256: the most that keeps 147,200 is 51
    WIDEST_FULL = 128  # channels up to which a block has one full matrix

    def __init__(self, width: int, generator: torch.Generator) -> None:
        super().__init__()
        self.activation = rounded_relu
        rank = self.BOTTLENECK if width > self.WIDEST_FULL else None
        self.blocks = nn.ModuleList(
            _Separable(3 if number == 1 else width, width, number in self.CONCATENATED, rank, generator)
            for number in range(1, self.BLOCKS + 1)
        )
        self.out_weight = nn.Parameter(_output_weight(width, 1, generator))
        self.out_bias = nn.Parameter(torch.zeros(1))
        self._start_as_sphere(generator)

    @torch.no_grad()
    def _start_as_sphere(self, generator: torch.Generator) -> None:
        """Scale the output layer so that the first field is that of a sphere.

        Alone, the geometric initialisation is right on average over many channels; a bottleneck of 48 is off by half.
        """
        q = torch.nn.functional.normalize(torch.randn(512, 3, generator=generator)) * -OUTPUT_BIAS
        self.out_weight.mul_(-OUTPUT_BIAS / self.forward(q).mean())
        self.out_bias.fill_(OUTPUT_BIAS)

    def layers(self) -> Sequence[Layer]:
        folded = [layer for block in self.blocks if isinstance(block, _Separable) for layer in block.layers()]
        return [*folded, Layer(self.out_weight, self.out_bias, None, has_activation=False)]


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
        pointwise = _hidden_weight(inputs, width, generator)
        if concatenated:
            pointwise[channels:] = 0  # geometric initialisation: the concatenated input has no effect at first
        self.narrow: nn.Parameter | None = None
        if rank is not None and channels > rank:
            # A random projection and its transpose keep the activations' variance and so the geometric start.
            self.narrow = nn.Parameter(_orthogonal(inputs, rank, generator) * math.sqrt(inputs / rank))
            pointwise = _hidden_weight(rank, width, generator)
        self.weight = nn.Parameter(pointwise)
        self.bias = nn.Parameter(torch.zeros(width))

    def layers(self) -> list[Layer]:
        first = self.weight if self.narrow is None else self.narrow
        folded, shifted = self.scale[:, None] * first, self.shift @ first
        of_query = folded[self.channels :] if self.concatenated else None
        if self.narrow is None:
            return [Layer(folded[: self.channels], self.bias + shifted, of_query, has_activation=True)]
        return [
            Layer(folded[: self.channels], shifted, of_query, has_activation=False),
            Layer(self.weight, self.bias, None, has_activation=True),
        ]


class NeuralPullNetwork(FieldNetwork):
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
            weight = (_output_weight if last else _hidden_weight)(inputs, outputs, generator)
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
            made.append(Layer(weight, bias, of_query, has_activation=number < self.HIDDEN))
        return made


def network_of(config: NetworkConfig) -> FieldNetwork:
    """Build the configured network with its initial weights, on the CPU; they depend on its seed alone."""
    generator = torch.Generator().manual_seed(config.seed)
    if config.model == "mlp":
        return NeuralPullNetwork(generator)
    return SeparableNetwork(config.width, generator)


def _hidden_weight(inputs: int, outputs: int, generator: torch.Generator) -> Tensor:
    """Geometric initialisation of a hidden layer: N(0, 2/C_out), which keeps |h| under a ReLU."""
    return torch.randn(inputs, outputs, generator=generator) * math.sqrt(2 / outputs)


def _output_weight(inputs: int, outputs: int, generator: torch.Generator) -> Tensor:
    """Geometric initialisation of the last layer: the mean of the channels, so that y ≈ |q| + the output bias."""
    return math.sqrt(math.pi / inputs) + 1e-4 * torch.randn(inputs, outputs, generator=generator)


def _orthogonal(inputs: int, outputs: int, generator: torch.Generator) -> Tensor:
    """Orthonormal columns (C_in,C_out)."""
    columns: Tensor = torch.linalg.qr(torch.randn(inputs, outputs, generator=generator))[0]
    return columns
