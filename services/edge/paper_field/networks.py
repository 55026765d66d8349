"""The networks: they map a query to its unsigned distance, and by a second pass to the distance's gradient.

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

from services.edge.field.compute import Nearest, several_nearest_in
from services.edge.paper_field.losses import MOST_CERTAIN
from services.edge.paper_field.losses import certainty as certainty_of
from services.edge.paper_field.network_config import INPUT_AT, NetworkConfig

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
    """Base class of the networks: the two passes at the head of this file."""

    activation: Activation = staticmethod(relu)

    def layers(self) -> Sequence[Layer]:
        """Compute the effective weights of all layers from the current parameters."""
        raise NotImplementedError

    def read(self, q: Tensor, certainty: Tensor | None) -> Tensor:
        """Return what the layers read of queries (M,3): (M,C), their places first."""
        return q

    def forward(self, q: Tensor, certainty: Tensor | None = None) -> Tensor:
        """q (M,3) in the unit frame -> f (M,) ≥ 0; certainty (M,): log(1/ω) for a network that reads it."""
        h = x = self.read(q, certainty)
        for layer in self.layers():
            z = _affine(h, x, layer)
            h = self.activation(z)[0] if layer.has_activation else z
        return h[:, 0].abs()

    def value_and_gradient(self, q: Tensor, certainty: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """As `forward` -> f (M,) and g = ∇f (M,3), both differentiable in the parameters and in q."""
        layers, slopes = self.layers(), []
        h = x = self.read(q, certainty)
        for layer in layers:
            h = _affine(h, x, layer)
            slope = None
            if layer.has_activation:
                h, slope = self.activation(h)
            slopes.append(slope)
        y = h
        back, g = y.sign(), torch.zeros_like(x)
        for layer, slope in zip(reversed(layers), reversed(slopes), strict=True):
            if slope is not None:
                back = back * slope
            if layer.of_query is not None:
                g = g + back @ layer.of_query.T
            back = back @ layer.weight.T
        return y[:, 0].abs(), (g + back)[:, :3]


def _affine(h: Tensor, x: Tensor, layer: Layer) -> Tensor:
    z = torch.addmm(layer.bias, h, layer.weight)
    return z if layer.of_query is None else torch.addmm(z, x, layer.of_query)


class SeparableNetwork(FieldNetwork):
    """The paper's network: six 1-D depthwise-separable convolutions, the input concatenated at the 2nd and the 5th.

    As read here, a layer is a depthwise convolution (a filter per channel), then a pointwise one (a matrix over the
    channels), then the activation, and nothing between the two (F. Chollet, "Xception", CVPR 2017, found it harmful).
    Over a batch of queries, which are no neighbours, the kernel size must be 1: a query's value must not depend on the
    other queries of its batch. The depthwise convolution is then a scale and a shift of every channel, which are folded
    into the matrix beforehand. So this is a multilayer perceptron, with 12 numbers in a thousand that change nothing
    that it can represent. `NeighbourNetwork` has a kernel of 3. A linear layer computes the distance from the last one.

    Where log(1/ω) is an input and none is given, that of the network's own distance is read, found by a pass with 0.
    """

    def __init__(self, config: NetworkConfig, generator: torch.Generator) -> None:
        super().__init__()
        self.activation = rounded_relu
        self.inputs = config.inputs
        self.blocks = _separable_layers(config, 1, generator)
        with torch.no_grad():
            self._blocks()[0].weight[3:] = 0  # the first field is a sphere whatever log(1/ω) is
        self.out_weight = nn.Parameter(_output_weight(config.widths[-1], 1, generator))
        self.out_bias = nn.Parameter(torch.zeros(1))
        self._start_as_sphere(generator)

    @torch.no_grad()
    def _start_as_sphere(self, generator: torch.Generator) -> None:
        """Scale the output layer so that the first field is that of a sphere.

        Alone, the geometric initialisation is right on average over many channels; layers of 128 are a tenth off.
        """
        q = torch.nn.functional.normalize(torch.randn(512, 3, generator=generator)) * -OUTPUT_BIAS
        self.out_weight.mul_(-OUTPUT_BIAS / self.forward(q, torch.zeros(len(q))).mean())
        self.out_bias.fill_(OUTPUT_BIAS)

    def _blocks(self) -> list[_Separable]:
        return [block for block in self.blocks if isinstance(block, _Separable)]

    def read(self, q: Tensor, certainty: Tensor | None) -> Tensor:
        if self.inputs == 3:
            return q
        if certainty is None:
            with torch.no_grad():
                certainty = certainty_of(self.forward(q, torch.zeros_like(q[:, 0])))
        return torch.cat([q, certainty[:, None] / MOST_CERTAIN], dim=1)

    def layers(self) -> Sequence[Layer]:
        return [
            *(block.folded() for block in self._blocks()),
            Layer(self.out_weight, self.out_bias, None, has_activation=False),
        ]


def _separable_layers(config: NetworkConfig, kernel: int, generator: torch.Generator) -> nn.ModuleList:
    return nn.ModuleList(
        _Separable(channels, width, config.inputs * (number in INPUT_AT), kernel, generator)
        for number, (channels, width) in enumerate(pairwise((config.inputs, *config.widths)), 1)
    )


class _Separable(nn.Module):
    """One layer: a depthwise filter (K,C_in) and its bias (C_in,), then a pointwise matrix (C_in,C_out) and its bias.

    read: channels of the query, concatenated behind the `channels` of the layer before; 0 where it reads none.
    """

    def __init__(self, channels: int, width: int, read: int, kernel: int, generator: torch.Generator) -> None:
        super().__init__()
        self.channels, self.read = channels, read
        inputs = channels + read
        taps = torch.zeros(kernel, inputs)
        taps[kernel // 2] = 1  # a wider kernel starts as one of size 1
        self.taps = nn.Parameter(taps)
        self.shift = nn.Parameter(torch.zeros(inputs))
        pointwise = _hidden_weight(inputs, width, generator)
        if read:
            pointwise[channels:] = 0  # geometric initialisation: the concatenated input has no effect at first
        self.weight = nn.Parameter(pointwise)
        self.bias = nn.Parameter(torch.zeros(width))

    def folded(self) -> Layer:
        """The effective weights of a kernel of size 1."""
        weight = self.taps[0][:, None] * self.weight
        of_query = weight[self.channels :] if self.read else None
        return Layer(weight[: self.channels], self.bias + self.shift @ self.weight, of_query, has_activation=True)

    def along(self, h: Tensor, count: int) -> Tensor:
        """Apply a kernel of size 3 to sequences (M,L,C_in), with 0 beyond both ends -> the first `count` places
        (M,count,C_out)."""
        padded = torch.nn.functional.pad(h[:, : count + 1], (0, 0, 1, max(0, count + 1 - h.shape[1])))
        before, here, after = (padded[:, start : start + count] for start in range(3))
        return (
            self.taps[0] * before + self.taps[1] * here + self.taps[2] * after + self.shift
        ) @ self.weight + self.bias


class NeighbourNetwork(FieldNetwork):
    """The paper's network with a kernel of size 3, over a query and its nearest points in the order of their distance.

    The sequence is q, p_1(q), …, p_K(q), places in the unit frame; the distance is computed from the query's own place
    after the sixth layer, which is reached from six places away: K ≤ 6. A query's value is independent of its batch,
    but jumps where another point becomes its k-th nearest. The gradient is that of q with its neighbours held.
    """

    def __init__(self, config: NetworkConfig, generator: torch.Generator) -> None:
        super().__init__()
        self.neighbours = config.neighbours
        self.blocks = _separable_layers(config, 3, generator)
        self.out_weight = nn.Parameter(_output_weight(config.widths[-1], 1, generator))
        self.out_bias = nn.Parameter(torch.full((1,), OUTPUT_BIAS))
        self._points = torch.zeros(0, 3)
        self._nearest: Nearest | None = None

    def use_points(self, points: Tensor) -> None:
        """Set the points (N,3) whose nearest are read, N ≥ K."""
        self._points, self._nearest = points, several_nearest_in(points, self.neighbours)

    def forward(self, q: Tensor, certainty: Tensor | None = None) -> Tensor:
        if self._nearest is None:
            raise ValueError("use_points was not called: the network has no points to find neighbours among")
        beside = self._points[self._nearest(q)].to(q)
        read = h = torch.cat([q[:, None], beside], dim=1)
        for number, block in enumerate(self.blocks, 1):
            assert isinstance(block, _Separable)
            if block.read:
                h = torch.cat([h, read[:, : h.shape[1]]], dim=2)
            count = min(len(self.blocks) - number + 1, read.shape[1])
            h = _rounded_relu_by_parts(block.along(h, count))
        return torch.addmm(self.out_bias, h[:, 0], self.out_weight)[:, 0].abs()

    def value_and_gradient(self, q: Tensor, certainty: Tensor | None = None) -> tuple[Tensor, Tensor]:
        wanted = torch.is_grad_enabled()
        with torch.enable_grad():
            at = q if q.requires_grad else q.detach().requires_grad_()
            f = self.forward(at)
            (g,) = torch.autograd.grad(f.sum(), at, create_graph=wanted)
        return (f, g) if wanted else (f.detach(), g)


def _rounded_relu_by_parts(z: Tensor) -> Tensor:
    """The rounded ReLU out of operations that autograd differentiates twice."""
    slope = (z * (0.5 / ROUNDING) + 0.5).clamp(0, 1)
    return torch.relu(z - ROUNDING) + ROUNDING * slope.square()


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
    return (NeighbourNetwork if config.neighbours else SeparableNetwork)(config, generator)


def _hidden_weight(inputs: int, outputs: int, generator: torch.Generator) -> Tensor:
    """Geometric initialisation of a hidden layer: N(0, 2/C_out), which keeps |h| under a ReLU."""
    return torch.randn(inputs, outputs, generator=generator) * math.sqrt(2 / outputs)


def _output_weight(inputs: int, outputs: int, generator: torch.Generator) -> Tensor:
    """Geometric initialisation of the last layer: the mean of the channels, so that y ≈ |q| + the output bias."""
    return math.sqrt(math.pi / inputs) + 1e-4 * torch.randn(inputs, outputs, generator=generator)
