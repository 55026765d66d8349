"""Both networks: their size, their gradient, their first field, and that a query stands alone."""

from __future__ import annotations

from typing import Any

import pytest
import torch

from capture2vr.edge.paper_field.losses import certainty
from capture2vr.edge.paper_field.network_config import NetworkConfig, parameter_count
from capture2vr.edge.paper_field.network_passes import BEND, ROUNDING, Layer, field_value_and_gradient
from capture2vr.edge.paper_field.networks import FieldNetwork, NeighbourNetwork, network_of

CONFIGS = {
    "128 and 256": NetworkConfig(),
    "169": NetworkConfig(widths=(169,) * 6),
    "128": NetworkConfig(widths=(128,) * 6),
    "certainty": NetworkConfig(certainty="input"),
    "kernel 3": NetworkConfig(widths=(168,) * 6, neighbours=6),
    "two neighbours": NetworkConfig(neighbours=2),
    "mlp": NetworkConfig(model="mlp"),
}
NETWORKS = pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS)
POINTS = torch.rand(200, 3, generator=torch.Generator().manual_seed(7)) - 0.5


def queries(count: int = 300) -> torch.Tensor:
    return torch.rand(count, 3, generator=torch.Generator().manual_seed(1)) - 0.5


def built(config: NetworkConfig, *, double: bool = False) -> FieldNetwork:
    network = network_of(config).double() if double else network_of(config)
    if isinstance(network, NeighbourNetwork):
        network.use_points(POINTS.double() if double else POINTS)
    return network


def in_double(config: NetworkConfig) -> FieldNetwork:
    return built(config, double=True)


def parameters_of(network: FieldNetwork) -> int:
    return sum(parameter.numel() for parameter in network.parameters())


def test_the_networks_have_the_papers_sizes() -> None:
    counts = {name: parameters_of(network_of(config)) for name, config in CONFIGS.items()}
    assert counts["mlp"] == 463_100
    # The paper prints 147.2 thousand, and 0.57 MB of 2^20 bytes, which are 149.4 thousand.
    assert counts["128 and 256"] == 152_339
    assert counts["169"] == 147_218
    assert counts["kernel 3"] == 147_205
    assert counts["128"] == 85_267
    assert counts == {name: parameter_count(config) for name, config in CONFIGS.items()}


@NETWORKS
def test_the_second_sweep_is_the_gradient(config: NetworkConfig) -> None:
    network, q = in_double(config), queries().double().requires_grad_()
    f, g = network.value_and_gradient(q)
    torch.testing.assert_close(network(q), f)
    (expected,) = torch.autograd.grad(f.sum(), q)
    torch.testing.assert_close(g, expected)


@NETWORKS
def test_a_loss_on_the_gradient_reaches_every_weight(config: NetworkConfig) -> None:
    network = in_double(config)
    f, g = network.value_and_gradient(queries().double())
    (f + g.square().sum(dim=1)).mean().backward()
    grads = [parameter.grad for parameter in network.parameters()]
    assert all(grad is not None and grad.isfinite().all() for grad in grads)


def by_autograd(
    network: FieldNetwork, q: torch.Tensor, known: torch.Tensor | None
) -> tuple[torch.Tensor, torch.Tensor]:
    """The same layers out of operations that autograd differentiates twice."""
    h = x = network.read(q, known)
    *hidden, out = network.layers()
    for layer in hidden:
        z = h @ layer.weight + layer.bias + (0 if layer.of_query is None else x @ layer.of_query)
        slope = (z * BEND + 0.5).clamp(0, 1)
        h = torch.relu(z - ROUNDING) + ROUNDING * slope.square() if network.rounded else z.relu()
    f = (h @ out.weight + out.bias)[:, 0].abs()
    (g,) = torch.autograd.grad(f.sum(), q, create_graph=True)
    return f, g


@pytest.mark.parametrize("read", ["both", "value", "gradient"])
@pytest.mark.parametrize("name", ["128 and 256", "certainty", "mlp"])
def test_the_backward_pass_by_hand_is_that_of_autograd(name: str, read: str) -> None:
    config = CONFIGS[name]
    network, chance = in_double(config), torch.Generator().manual_seed(3)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter += 0.05 * torch.randn(parameter.shape, generator=chance, dtype=parameter.dtype)
    q = queries().double().requires_grad_()
    known = torch.rand(len(q), generator=chance).double() if config.inputs == 4 else None
    turn, push = torch.randn(len(q), 3, generator=chance).double(), torch.randn(len(q), generator=chance).double()

    def derivatives(f: torch.Tensor, g: torch.Tensor) -> list[torch.Tensor]:
        loss = (push * f.square()).sum() if read != "gradient" else f.new_zeros(())
        if read != "value":
            loss = loss + (turn * g + g.square()).sum()
        wanted = [q, *network.parameters()]
        found = torch.autograd.grad(loss, wanted, allow_unused=True, materialize_grads=True)
        return [f.detach(), g.detach(), *found]

    for ours, expected in zip(
        derivatives(*network.value_and_gradient(q, known)), derivatives(*by_autograd(network, q, known)), strict=True
    ):
        torch.testing.assert_close(ours, expected)


@NETWORKS
def test_weights_that_are_held_for_several_passes_give_the_same_gradients(config: NetworkConfig) -> None:
    def loss(network: FieldNetwork) -> torch.Tensor:
        f, g = network.value_and_gradient(queries().double())
        return (f + g.square().sum(dim=1)).mean() + network(queries(5).double()).mean()

    held, plain = in_double(config), in_double(config)
    with held.hold_weights():
        loss(held).backward()
    loss(plain).backward()
    for one, other in zip(held.parameters(), plain.parameters(), strict=True):
        torch.testing.assert_close(one.grad, other.grad)
    with torch.no_grad():
        for parameter in held.parameters():
            parameter.mul_(0.5)
    assert not torch.equal(held(queries().double()), plain(queries().double()))


def test_a_second_backward_pass_is_refused_because_the_first_wrote_over_what_it_needs() -> None:
    network = in_double(CONFIGS["128"])
    f, g = network.value_and_gradient(queries().double())
    loss = (f + g[:, 0]).sum()
    loss.backward(retain_graph=True)
    with pytest.raises(RuntimeError, match="a second time"):
        loss.backward()


@NETWORKS
def test_the_gradient_is_right_to_differences(config: NetworkConfig) -> None:
    network, q = in_double(config), queries(50).double()
    for axis, step in enumerate(1e-6 * torch.eye(3, dtype=torch.float64)):
        known = torch.zeros(len(q), dtype=torch.float64)
        _, g = network.value_and_gradient(q, known)
        slope = (network(q + step, known) - network(q - step, known)) / 2e-6
        torch.testing.assert_close(g[:, axis], slope, atol=1e-6, rtol=1e-5)


def test_a_certainty_that_is_not_given_is_that_of_the_networks_own_distance() -> None:
    network, q = built(CONFIGS["certainty"]), queries()
    with torch.no_grad():
        network._blocks()[0].weight[3:] = 1  # type: ignore[operator,index]  # it starts without effect
    unknown = network(q, torch.zeros(len(q)))
    torch.testing.assert_close(network(q), network(q, certainty(unknown)))
    assert (network(q) - unknown).abs().max() > 0.01


def test_a_kernel_of_3_reads_the_neighbours_and_the_order_of_their_distance() -> None:
    network, q = built(CONFIGS["kernel 3"]), queries()
    with torch.no_grad():
        for block in network.blocks:  # type: ignore[union-attr]
            block.taps[2] = 0.3  # type: ignore[index,union-attr]  # it starts as a kernel of 1
    before = network(q)
    network.use_points(POINTS.flip(0))  # type: ignore[operator]
    torch.testing.assert_close(network(q), before)
    network.use_points(POINTS + 0.05)  # type: ignore[operator]
    assert (network(q) - before).abs().max() > 1e-3


def test_a_network_without_its_points_says_so() -> None:
    with pytest.raises(ValueError, match="use_points"):
        network_of(CONFIGS["kernel 3"])(queries())


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"widths": (128, 256)}, "widths = \\[128, 256\\]: the network has 6 layers"),
        ({"widths": (128,) * 5 + (0,)}, "at least one channel"),
        ({"neighbours": 7}, "reach at most 6"),
        ({"weak_per_m2": 2_000.0}, "at most strong_per_m2, which is 1000"),
        ({"neighbours": 2, "certainty": "input"}, "cannot be combined"),
    ],
)
def test_settings_of_which_no_network_can_be_built_are_refused(wrong: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        NetworkConfig(**wrong)


@NETWORKS
def test_a_random_network_is_the_field_of_a_sphere(config: NetworkConfig) -> None:
    directions = torch.nn.functional.normalize(queries() + 1e-3)
    f = built(config)(directions * 0.5)
    assert f.mean() < 0.1
    assert built(config)(directions).mean() > 0.3
    assert (f >= 0).all()


@NETWORKS
def test_a_querys_value_does_not_depend_on_its_batch(config: NetworkConfig) -> None:
    network, q = in_double(config), queries().double()
    torch.testing.assert_close(network(q)[17:18], network(q[17:18]))


@NETWORKS
def test_a_seed_gives_one_network(config: NetworkConfig) -> None:
    torch.manual_seed(5)
    first = built(config)(queries())
    torch.manual_seed(6)
    torch.testing.assert_close(built(config)(queries()), first, rtol=0, atol=0)


def test_the_rounded_relu_is_a_relu_but_for_its_bend_and_has_its_own_slope() -> None:
    one = torch.ones(1, 1, dtype=torch.float64)
    layers = [Layer(one, torch.zeros(1).double(), None), Layer(one, torch.ones(1).double(), None)]  # y = a(z) + 1 > 0

    def rounded_relu(z: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        f, slope = field_value_and_gradient(z[:, None], layers, rounded=True)
        return f - 1, slope[:, 0]

    z = torch.linspace(-0.1, 0.1, 201, dtype=torch.float64).requires_grad_()
    value, slope = rounded_relu(z)
    assert (value - z.relu()).abs().max() <= 0.0051  # a quarter of the half-width
    torch.testing.assert_close(torch.autograd.grad(rounded_relu(z)[0].sum(), z)[0], slope)
    inside = (z.detach() - 0.0004).requires_grad_()  # off the corners of the slope
    for part in (0, 1):  # not gradcheck, which runs a backward pass again and again
        (found,) = torch.autograd.grad(rounded_relu(inside)[part].sum(), inside)
        beside = [rounded_relu(inside.detach() + step)[part] for step in (1e-6, -1e-6)]
        torch.testing.assert_close(found, (beside[0] - beside[1]) / 2e-6, rtol=1e-3, atol=1e-5)
