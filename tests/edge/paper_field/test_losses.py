"""Every equation: zero where the field is right, bounded where it is wrong, finite gradients at its corners."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from capture2vr.edge.paper_field import losses

QUERIES = torch.rand(500, 3, generator=torch.Generator().manual_seed(2)) - 0.5


def sphere(q: Tensor) -> tuple[Tensor, Tensor]:
    """Distance to a sphere of radius 0.3, and its gradient."""
    radius = q.norm(dim=1)
    signed = radius - 0.3
    return signed.abs(), q / radius[:, None] * signed.sign()[:, None]


def plane(q: Tensor) -> tuple[Tensor, Tensor]:
    """Distance to z = 0, and its gradient."""
    return q[:, 2].abs(), torch.stack([0 * q[:, 0], 0 * q[:, 1], q[:, 2].sign()], dim=1)


@pytest.mark.parametrize("field", [sphere, plane])
def test_a_perfect_field_pulls_onto_the_surface_and_costs_nothing(field: object) -> None:
    f, g = field(QUERIES)  # type: ignore[operator]
    moved = losses.pull(QUERIES, f, g)
    assert field(moved)[0].max() < 1e-6  # type: ignore[operator]
    assert losses.chamfer_loss(moved, moved, moved, moved) < 1e-7
    assert losses.projection_loss(f, g, -g, growth=-10) < 1e-6
    assert losses.orthogonality_loss(g, QUERIES, moved) < 1e-3  # float32: a query on the surface has no direction
    assert losses.surface_loss(field(moved)[0]) < 1e-6  # type: ignore[operator]
    assert losses.self_consistency_loss(f[:, None], f[:, None], f) < 1e-7


def test_chamfer_adds_both_directions() -> None:
    here, there = torch.zeros(4, 3), torch.tensor([[3.0, 4.0, 0.0]]).repeat(4, 1)
    assert losses.chamfer_loss(here, there, there, there) == pytest.approx(5.0)
    assert losses.chamfer_loss(here, there, here, there) == pytest.approx(10.0)


def test_the_pull_ignores_how_long_the_gradient_is() -> None:
    f, g = sphere(QUERIES)
    torch.testing.assert_close(losses.pull(QUERIES, f, 7 * g), losses.pull(QUERIES, f, g))


def test_directions_count_as_lines_and_fade_or_grow_with_the_distance() -> None:
    f, g = sphere(QUERIES)
    across = torch.linalg.cross(g, g.roll(1, dims=1))
    assert losses.projection_loss(f, g, g, growth=-10) == pytest.approx(0, abs=1e-6)
    assert losses.projection_loss(0 * f, g, across, growth=-10) == pytest.approx(1, abs=1e-5)
    for growth in (-10, 10):  # λ as it trains, and as it is printed
        near, far = (losses.projection_loss(0 * f + d, g, across, growth=growth) for d in (0.0, 0.1))
        assert far / near == pytest.approx(math.exp(growth / 10), rel=1e-4)


def test_orthogonality_is_one_where_the_gradient_runs_along_the_surface() -> None:
    _, g = plane(QUERIES)
    aside = QUERIES + torch.tensor([0.1, 0.0, 0.0])
    assert losses.orthogonality_loss(g, QUERIES, aside) == pytest.approx(1, abs=1e-5)


def test_the_memory_starts_at_the_first_prediction_and_forgets() -> None:
    weak = torch.tensor([0.2, 0.4], requires_grad=True)
    memory = losses.update_memory(torch.tensor([math.nan, 0.1]), weak, keep=0.9)
    torch.testing.assert_close(memory, torch.tensor([0.2, 0.13]))
    assert not memory.requires_grad


def test_pairs_near_the_surface_weigh_most_within_bounds() -> None:
    strong, weak = torch.full((1, 1), 0.2), torch.full((1, 1), 0.1)
    weights = [losses.certainty(torch.tensor([memory])) for memory in (0.0, 1e-9, 1e-4, 0.01, 1, 50)]
    at = [float(losses.self_consistency_loss(strong, weak, weight)) for weight in weights]
    assert losses.self_consistency_loss(strong, weak, None) == pytest.approx(0.1)
    assert losses.certainty(torch.tensor([math.nan])) == 0
    assert at[:3] == pytest.approx([0.1 * math.log(1e4)] * 3, rel=1e-4)
    assert at[3] == pytest.approx(0.1 * math.log(100), rel=1e-4)
    assert at[4:] == pytest.approx([1e-8, 1e-8])


def test_the_way_to_the_surface_is_continuous_where_the_gradient_turns_round() -> None:
    f, g = plane(QUERIES)
    across, gradient = plane(QUERIES * torch.tensor([1.0, 1.0, -1.0]))
    there, back = losses.pull_vector(f, g), losses.pull_vector(across, 5 * gradient)
    torch.testing.assert_close(there, QUERIES * torch.tensor([0.0, 0.0, 1.0]))
    torch.testing.assert_close(back, -there)
    both = losses.self_consistency_loss(there, back, None)
    assert both == pytest.approx(float(2 * f.mean()), rel=1e-3)  # the distances alone would agree


def test_gradients_are_finite_where_everything_is_zero() -> None:
    zero = torch.zeros(3, 3, requires_grad=True)
    f = torch.zeros(3, requires_grad=True)
    moved = losses.pull(zero, f, zero)
    total = (
        losses.chamfer_loss(moved, moved.detach(), moved.detach(), moved)
        + losses.projection_loss(f, zero, zero, growth=-10)
        + losses.orthogonality_loss(zero, zero, zero.detach())
        + losses.self_consistency_loss(f[:, None], f[:, None], torch.ones(3))
        + losses.self_consistency_loss(losses.pull_vector(f, zero), losses.pull_vector(f, zero), torch.ones(3))
        + losses.far_loss(f, f.detach())
    )
    for grad in torch.autograd.grad(total, [zero, f]):
        assert grad.isfinite().all()


def test_the_total_is_the_weighted_sum() -> None:
    terms = {"a": torch.tensor(2.0), "b": torch.tensor(3.0)}
    assert losses.total_loss(terms, {"a": 1.0, "b": 0.1}) == pytest.approx(2.3)
