"""The objectives of the training: a batch of query indices in, the loss terms by name out.

Everything that a step reads stays in the same tensors from step to step, so that one CUDA graph can capture it all.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import torch
from torch import Tensor

from capture2vr.edge.field.compute import nearest, nearest_in, rows
from capture2vr.edge.paper_field import losses
from capture2vr.edge.paper_field.network_config import NetworkConfig, far_batch
from capture2vr.edge.paper_field.networks import FieldNetwork
from capture2vr.edge.paper_field.queries import Pool

Objective = Callable[[Tensor], Mapping[str, Tensor]]
"""Indices of a batch (M,) into the pool -> the loss terms by name."""


def regression_objective(network: FieldNetwork, pool: Pool, target: Tensor) -> Objective:
    """The objective of the warm start: the field at the queries j should be target[j]."""

    def terms(j: Tensor) -> Mapping[str, Tensor]:
        return {"regression": losses.regression_loss(network(pool.strong_queries(j)), target[j])}

    return terms


def paper_weights(config: NetworkConfig) -> Mapping[str, float]:
    """Weights by term of (7), and of the far queries; terms of weight 0 are left out.

    A far query counts as much as one of (1), because both measure the error of a query's distance.
    """
    weights = {
        "chamfer": config.chamfer,
        "projection": config.projection,
        "orthogonality": config.orthogonality,
        "surface": config.surface,
        "self_consistency": config.self_consistency,
        "far": config.far_share * config.chamfer,
    }
    return {name: weight for name, weight in weights.items() if weight > 0}


def paper_objective(network: FieldNetwork, pool: Pool, memory: Tensor, config: NetworkConfig, batch: int) -> Objective:
    """The objective of the paper, with the terms of (7); memory (J,) is ω, which every step updates in place."""
    wanted = paper_weights(config)
    nearest_point = nearest_in(pool.points)
    far_count = min(far_batch(config, batch), len(pool.far))
    growth = config.decay if config.sign == "printed" else -config.decay
    ways = "self_consistency" in wanted and config.pairs == "pull"

    def terms(j: Tensor) -> Mapping[str, Tensor]:
        with network.hold_weights():
            return of_batch(j)

    def of_batch(j: Tensor) -> Mapping[str, Tensor]:
        q, near_q = pool.strong_queries(j), pool.points[pool.nearest[j]]
        known = losses.certainty(memory[j])
        if ways:  # both queries of a pair in one pass, which has half the kernels of two
            both = network.value_and_gradient(torch.cat([q, pool.weak_queries(j)]), known.repeat(2))
        else:
            both = network.value_and_gradient(q, known)
        f, g = both[0][: len(j)], both[1][: len(j)]
        moved = losses.pull(q, f, g)
        found = {}
        if "chamfer" in wanted:
            to_point = pool.points[nearest_point(moved)]
            found["chamfer"] = losses.chamfer_loss(moved, to_point, near_q, rows(moved, nearest(near_q, moved)))
        if "projection" in wanted:
            _, g_moved = network.value_and_gradient(moved)
            found["projection"] = losses.projection_loss(f, g, g_moved, growth=growth)
        if "orthogonality" in wanted:
            found["orthogonality"] = losses.orthogonality_loss(g, q, near_q)
        if "surface" in wanted:
            found["surface"] = losses.surface_loss(network(near_q))
        if "self_consistency" in wanted:
            found["self_consistency"] = of_pairs(j, *both, known)
        if "far" in wanted:
            far = j[:far_count] % len(pool.far)  # j is random, so this is a random choice among the far queries too
            found["far"] = losses.far_loss(network(pool.far[far]), pool.far_distance[far])
        return found

    def of_pairs(j: Tensor, f: Tensor, g: Tensor, known: Tensor) -> Tensor:
        """L_sc, which updates ω on the way; f, g of the strong queries, then of the weak ones where `ways` count."""
        if ways:
            weak_distance, (strong, weak) = f[len(j) :], losses.pull_vector(f, g).chunk(2)
        else:
            weak_distance = network(pool.weak_queries(j), known)
            strong, weak = f[:, None], weak_distance[:, None]
        omega = losses.update_memory(memory[j], weak_distance, keep=config.memory)
        memory[j] = omega
        weight = losses.certainty(omega) if config.certainty == "weight" else None
        return losses.self_consistency_loss(strong, weak, weight)

    return terms
