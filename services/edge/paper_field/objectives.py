"""Which queries each loss sees: one batch of indices in, the terms by name out.

Everything that a step reads stays in the same tensors from step to step, so a CUDA graph can hold the whole of it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import torch
from torch import Tensor

from services.edge.field import losses
from services.edge.field.compute import nearest, nearest_in, rows
from services.edge.field.config import FitConfig
from services.edge.field.networks import FieldNetwork
from services.edge.field.queries import Pool, far_batch

Objective = Callable[[Tensor], Mapping[str, Tensor]]
"""Indices of a batch (M,) into the pool -> the loss terms by name."""


def regression_objective(network: FieldNetwork, pool: Pool, target: Tensor) -> Objective:
    """The warm start: at the queries j the field is target[j]."""

    def terms(j: Tensor) -> Mapping[str, Tensor]:
        return {"regression": losses.regression_loss(network(pool.strong_queries(j)), target[j])}

    return terms


def paper_weights(config: FitConfig) -> Mapping[str, float]:
    """The weights of (7), and of the far queries; what weighs nothing is not computed.

    A far query counts as much as one of (1), for both measure how far off a query's distance is.
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


def paper_objective(network: FieldNetwork, pool: Pool, memory: Tensor, config: FitConfig, batch: int) -> Objective:
    """The terms of (7); memory (J,) is ω, which every step updates in place."""
    wanted = paper_weights(config)
    nearest_point = nearest_in(pool.points)
    far_count = min(far_batch(config, batch), len(pool.far))

    def terms(j: Tensor) -> Mapping[str, Tensor]:
        q, near_q = pool.strong_queries(j), pool.points[pool.nearest[j]]
        f, g = network.value_and_gradient(q)
        moved = losses.pulled(q, f, g)
        found = {}
        if "chamfer" in wanted:
            to_point = pool.points[nearest_point(moved)]
            found["chamfer"] = losses.chamfer_loss(moved, to_point, near_q, rows(moved, nearest(near_q, moved)))
        if "projection" in wanted:
            _, g_moved = network.value_and_gradient(moved)
            found["projection"] = losses.projection_loss(f, g, g_moved, decay=config.decay)
        if "orthogonality" in wanted:
            found["orthogonality"] = losses.orthogonality_loss(g, q, near_q)
        found.update(values_only(j, f, near_q))
        return {name: found[name] for name in wanted}

    def values_only(j: Tensor, f: Tensor, near_q: Tensor) -> Mapping[str, Tensor]:
        """The terms that need no gradient, their queries through the network at once."""
        far = j[:far_count] % len(pool.far)  # j is random, so this is a random choice among the far queries too
        queries: Mapping[str, Callable[[], Tensor]] = {
            "surface": lambda: near_q,
            "self_consistency": lambda: pool.weak_queries(j),
            "far": lambda: pool.far[far],
        }
        parts = {name: make() for name, make in queries.items() if name in wanted}
        if not parts:
            return {}
        sizes = [len(part) for part in parts.values()]
        split = torch.split(network(torch.cat(list(parts.values()))), sizes)
        of = dict(zip(parts, split, strict=True))
        found = {}
        if "surface" in of:
            found["surface"] = losses.surface_loss(of["surface"])
        if "self_consistency" in of:
            omega = losses.update_memory(memory[j], of["self_consistency"], keep=config.memory)
            memory[j] = omega
            found["self_consistency"] = losses.self_consistency_loss(f, of["self_consistency"], omega)
        if "far" in of:
            found["far"] = losses.far_loss(of["far"], pool.far_distance[far])
        return found

    return terms
