"""Both networks: their size, their gradient, their first field, and that a query stands alone."""

from __future__ import annotations

import pytest
import torch

from services.edge.paper_field.network_config import NetworkConfig
from services.edge.paper_field.networks import FieldNetwork, network_of, rounded_relu

CONFIGS = [NetworkConfig(), NetworkConfig(width=256), NetworkConfig(model="mlp")]
NETWORKS = pytest.mark.parametrize("config", CONFIGS, ids=["128", "256", "mlp"])


def queries(count: int = 300) -> torch.Tensor:
    return torch.rand(count, 3, generator=torch.Generator().manual_seed(1)) - 0.5


def in_double(config: NetworkConfig) -> FieldNetwork:
    return network_of(config).double()


def parameters_of(network: FieldNetwork) -> int:
    return sum(parameter.numel() for parameter in network.parameters())


def test_the_networks_have_the_papers_sizes() -> None:
    small, wide, ancestors = (parameters_of(network_of(config)) for config in CONFIGS)
    assert ancestors == 463_100
    assert small < wide <= 147_200


@NETWORKS
def test_the_second_sweep_is_the_gradient(config: NetworkConfig) -> None:
    network, q = in_double(config), queries().double().requires_grad_()
    f, g = network.value_and_gradient(q)
    torch.testing.assert_close(network(q), f)
    (expected,) = torch.autograd.grad(f.sum(), q)
    torch.testing.assert_close(g, expected)


@NETWORKS
def test_a_loss_on_the_gradient_reaches_the_weights_as_by_double_backward(config: NetworkConfig) -> None:
    network, q = in_double(config), queries().double()
    f, g = network.value_and_gradient(q)
    (f + g.square().sum(dim=1)).mean().backward()
    swept = [parameter.grad.clone() for parameter in network.parameters() if parameter.grad is not None]
    network.zero_grad()
    free = q.clone().requires_grad_()
    f = network(free)
    if config.model == "mlp":  # autograd knows the derivative of a ReLU's slope: none
        (g,) = torch.autograd.grad(f.sum(), free, create_graph=True)
        (f + g.square().sum(dim=1)).mean().backward()
        expected = [parameter.grad for parameter in network.parameters() if parameter.grad is not None]
        for a, b in zip(swept, expected, strict=True):
            torch.testing.assert_close(a, b)
    assert len(swept) == len(list(network.parameters()))
    assert all(grad.isfinite().all() for grad in swept)


@NETWORKS
def test_a_random_network_is_the_field_of_a_sphere(config: NetworkConfig) -> None:
    directions = torch.nn.functional.normalize(queries() + 1e-3)
    f = network_of(config)(directions * 0.5)
    assert f.mean() < 0.1
    assert network_of(config)(directions).mean() > 0.3
    assert (f >= 0).all()


@NETWORKS
def test_a_querys_value_does_not_depend_on_its_batch(config: NetworkConfig) -> None:
    network, q = in_double(config), queries().double()
    torch.testing.assert_close(network(q)[17:18], network(q[17:18]))


@NETWORKS
def test_a_seed_gives_one_network(config: NetworkConfig) -> None:
    torch.manual_seed(5)
    first = network_of(config)(queries())
    torch.manual_seed(6)
    torch.testing.assert_close(network_of(config)(queries()), first, rtol=0, atol=0)


def test_the_rounded_relu_is_a_relu_but_for_its_bend_and_has_its_own_slope() -> None:
    z = torch.linspace(-0.1, 0.1, 201, dtype=torch.float64).requires_grad_()
    value, slope = rounded_relu(z)
    assert (value - z.relu()).abs().max() <= 0.0051  # a quarter of the half-width
    torch.testing.assert_close(torch.autograd.grad(value.sum(), z, retain_graph=True)[0], slope)
    inside = (z.detach() - 0.0004).requires_grad_()  # off the corners of the slope
    assert torch.autograd.gradcheck(rounded_relu, (inside,))
