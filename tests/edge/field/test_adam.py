"""Adam without PyTorch's optimiser classes: the same numbers, bit for bit, and a state that survives a checkpoint."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from capture2vr.edge.field.adam import Adam

BETAS = (0.9, 0.99)
STEPS = 30


def parameters() -> list[Tensor]:
    """A matrix, a vector, and a parameter that no loss depends on."""
    torch.manual_seed(0)
    return [torch.randn(shape).requires_grad_() for shape in ((40, 6), (7,), (3,))]


def train(trained: list[Tensor], optimiser: Any, rate: Tensor, steps: range) -> None:
    for step in steps:
        rate.fill_(0.1 * (1 - step / STEPS))
        optimiser.zero_grad()
        (trained[0].square().sum().sqrt() + trained[1].sin().sum()).backward()
        optimiser.step()


def trained_by(make: Callable[[list[Tensor], Tensor], Any]) -> list[Tensor]:
    trained, rate = parameters(), torch.tensor(0.1)
    train(trained, make(trained, rate), rate, range(STEPS))
    return trained


@pytest.fixture
def ours() -> list[Tensor]:
    return trained_by(lambda trained, rate: Adam(trained, rate, BETAS))


def test_it_moves_as_the_optimiser_of_pytorch_does(ours: list[Tensor]) -> None:
    theirs = trained_by(lambda trained, rate: torch.optim.Adam(trained, lr=rate, betas=BETAS, fused=True))
    assert all(torch.equal(one, other) for one, other in zip(ours, theirs, strict=True))
    assert not torch.equal(ours[0], parameters()[0])
    assert torch.equal(ours[2], parameters()[2]), "a parameter without a gradient stays"


def test_it_goes_on_from_a_checkpoint_as_if_nothing_had_happened(ours: list[Tensor]) -> None:
    trained, rate = parameters(), torch.tensor(0.1)
    first = Adam(trained, rate, BETAS)
    train(trained, first, rate, range(10))
    second = Adam(trained, rate, BETAS)
    second.load_state_dict(first.state_dict())
    train(trained, second, rate, range(10, STEPS))
    assert all(torch.equal(one, other) for one, other in zip(ours, trained, strict=True))
