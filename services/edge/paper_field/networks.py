"""The networks: they map a query (M,3) to its unsigned distance, and by a second pass to the distance's gradient."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise

import torch
from torch import Tensor, nn

from capture2vr.edge.field.compute import Nearest, several_nearest_in
from capture2vr.edge.paper_field.losses import MOST_CERTAIN
from capture2vr.edge.paper_field.losses import certainty as certainty_of
from capture2vr.edge.paper_field.network_config import INPUT_AT, NetworkConfig
from capture2vr.edge.paper_field.network_passes import BEND, ROUNDING, Layer, field_value, field_value_and_gradient

OUTPUT_BIAS = -0.5  # geometric initialisation (SAL, Atzmon & Lipman 2020): the field of a sphere of this radius


class FieldNetwork(nn.Module):
    """Base class of the networks: the passes of network_passes.py over the layers of the current parameters."""

    rounded = False
    """Whether the activation is the rounded ReLU."""
    _held: Sequence[Layer] | None = None

    @contextmanager
    def hold_weights(self) -> Iterator[None]:
        """Cache the effective weights for several passes, while the parameters do not change (a context manager).

        A step on a GPU has then a third fewer kernels, each of which takes its 2 µs however small it is.
        """
        self._held = self.layers()
        try:
            yield
        finally:
            self._held = None

    def layers(self) -> Sequence[Layer]:
        """Compute the effective weights of all layers from the current parameters."""
        raise NotImplementedError

    def read(self, q: Tensor, certainty: Tensor | None) -> Tensor:
        """Return what the layers read of queries (M,3): (M,C), their places first."""
        return q

    def forward(self, q: Tensor, certainty: Tensor | None = None) -> Tensor:
        """q (M,3) in the unit frame -> f (M,) ≥ 0; certainty (M,): log(1/ω) for a network that reads it."""
        return field_value(self.read(q, certainty), self._held or self.layers(), rounded=self.rounded)

    def value_and_gradient(self, q: Tensor, certainty: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """As `forward` -> f (M,) and g = ∇f (M,3), both differentiable in the parameters and in q."""
        layers = self._held or self.layers()
        f, g = field_value_and_gradient(self.read(q, certainty), layers, rounded=self.rounded)
        return f, g[:, :3]


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

    rounded = True

    def __init__(self, config: NetworkConfig, generator: torch.Generator) -> None:
        super().__init__()
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
            Layer(self.out_weight, self.out_bias, None),
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
        return Layer(weight[: self.channels], self.bias + self.shift @ self.weight, of_query)

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

    def layers(self) -> Sequence[Layer]:
        return ()  # its passes are autograd's, over the parameters

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
            h = _rounded_relu(block.along(h, count))
        return torch.addmm(self.out_bias, h[:, 0], self.out_weight)[:, 0].abs()

    def value_and_gradient(self, q: Tensor, certainty: Tensor | None = None) -> tuple[Tensor, Tensor]:
        wanted = torch.is_grad_enabled()
        with torch.enable_grad():
            at = q if q.requires_grad else q.detach().requires_grad_()
            f = self.forward(at)
            (g,) = torch.autograd.grad(f.sum(), at, create_graph=wanted)
        return (f, g) if wanted else (f.detach(), g)


def _rounded_relu(z: Tensor) -> Tensor:
    """The rounded ReLU of network_passes.py out of operations that autograd differentiates twice."""
    slope = (z * BEND + 0.5).clamp(0, 1)
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
            made.append(Layer(weight, bias, of_query))
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
