"""The training loop of a network: its state, checkpoint, optimiser steps and early stopping."""

from __future__ import annotations

import math
import time
from collections.abc import Generator, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import torch
from torch import Tensor

from capture2vr.edge.arrays import Floats
from capture2vr.edge.field import checkpoint as checkpoints
from capture2vr.edge.field.adam import Adam
from capture2vr.edge.field.compute import capture_step
from capture2vr.edge.field.schedule import warm_up_cosine
from capture2vr.edge.field.step import PER_YIELD, STEPS_BEFORE_CAPTURE, Step, refuse_divergence
from capture2vr.edge.paper_field.learned import learned_field
from capture2vr.edge.paper_field.losses import total_loss
from capture2vr.edge.paper_field.network_config import NetworkConfig
from capture2vr.edge.paper_field.networks import NeighbourNetwork, network_of
from capture2vr.edge.paper_field.objectives import Objective
from capture2vr.edge.paper_field.queries import Batches, Pool

EXPLODED = 10.0  # loss, in unit frames, above which a fit has diverged: pulled queries lie ten boxes away
WARM_START_RISE = 50  # warm-up steps of the warm start: Adam's first steps have no estimate of the variance
RESIDUAL_EVERY = 50  # steps between two evaluations at the held-out points; a multiple of `PER_YIELD`
BETTER = 0.99  # of the best residual: what is not below this is no improvement; two seeds differ by more than 1 %

Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class Best:
    """The least residual on the held-out points so far, its step, and the weights of that step."""

    residual: float
    at: int
    weights: Mapping[str, Tensor]


class NetworkRun:
    """The state of one fit.

    done     number of steps done;  ended  whether patience has ended the fit;  losses  of the last step
    added    (K,3) points of the densification round, or None before it
    memory   ω (J,) of the pool in use, or None before its first loss
    """

    def __init__(
        self,
        xyz: Floats,
        config: NetworkConfig,
        device: torch.device,
        held_out: Floats | None,
        checkpoint: Path | None,
        metres: float | None,
    ) -> None:
        self.config, self.device, self.done, self.ended = config, device, 0, False
        self.losses: dict[str, float] = {}
        self.network = network_of(config).to(device)
        if isinstance(self.network, NeighbourNetwork):
            self.network.use_points(torch.from_numpy(xyz).to(device))
        self.added: Floats | None = None
        self.memory: Tensor | None = None
        self._best: Best | None = None
        # A tensor, because a captured CUDA graph reads it from a fixed address.
        self._rate = torch.tensor(config.learning_rate, device=device)
        self._optimiser = Adam(self.network.parameters(), self._rate)
        self._held_out = None if held_out is None else torch.as_tensor(held_out, dtype=torch.float32, device=device)
        self._field = learned_field(self.network, xyz)
        self._checkpoint = checkpoint
        self._mark = checkpoints.fingerprint((config, metres), device, xyz, held_out)
        self._written = time.monotonic()
        if checkpoint and (state := checkpoints.load(checkpoint, self._mark, device)):
            self._restore(state)

    def step(self, losses: Mapping[str, float]) -> Step:
        """Build the step for the caller."""
        return Step(self.done, self.config.total_steps, losses, self._field)

    def yield_steps(self, work: Iterator[Result | None]) -> Generator[Step, None, Result]:
        """Run work that yields None between its parts and its result last; yields a step for every None."""
        for result in work:
            if result is not None:
                return result
            yield self.step({})
        raise AssertionError("the work ended without a result")

    def memory_of(self, pool: Pool) -> Tensor:
        """Return ω of this pool: that of the checkpoint, or NaN for every pair."""
        if self.memory is None:
            self.memory = torch.full((len(pool),), math.nan, device=self.device)
        return self.memory

    def add_points(self, added: Floats) -> None:
        """Store the points of the densification round. The next pool has other queries, so ω starts again."""
        self.added, self.memory = added, None

    def descend(
        self, objective: Objective, weights: Mapping[str, float], batches: Batches, until: int
    ) -> Iterator[Step]:
        """Train up to step number `until`, or until patience ends the fit; yields steps."""
        j = torch.zeros(batches.size, dtype=torch.int64, device=self.device)
        values = torch.zeros(1 + len(weights), device=self.device)

        def descent() -> None:
            self._optimiser.zero_grad()
            terms = objective(j)
            total = total_loss(terms, weights)
            total.backward()  # type: ignore[no-untyped-call]
            self._optimiser.step()
            values.copy_(torch.stack([total, *terms.values()]).detach())

        run, start = descent, self.done
        while self.done < until and not self.ended:
            j.copy_(batches.at(self.done))
            self._rate.fill_(learning_rate(self.done, self.config))
            run()
            self.done += 1
            if self.done - start == STEPS_BEFORE_CAPTURE:
                run = capture_step(descent, self.device)
            if self.done % PER_YIELD[self.device.type] == 0 or self.done == until:
                self.losses = dict(zip(("total", *weights), values.tolist(), strict=True))
                refuse_divergence(self.losses, EXPLODED, self.config.learning_rate, self.done)
                self._check_held_out()
                self._write()
                yield self.step(self.losses)

    def restore_best(self) -> bool:
        """Restore the weights with the least residual on the held-out points. Returns False where there are none."""
        if self._best is None:
            return False
        self.network.load_state_dict(self._best.weights)
        return True

    @torch.no_grad()
    def _check_held_out(self) -> None:
        """Evaluate the held-out points now and then: keep the best weights, end the fit when patience is used up."""
        patience = self.config.patience
        if self._held_out is None or not patience or self.done % RESIDUAL_EVERY or self.done <= self.config.warm_start:
            return
        residual = float(self.network(self._held_out).mean())
        if self._best is None or residual < BETTER * self._best.residual:
            weights = {name: tensor.clone() for name, tensor in self.network.state_dict().items()}
            self._best = Best(residual, self.done, weights)
        self.ended = self.done - self._best.at >= patience

    def _write(self) -> None:
        """Write the checkpoint, if the last one is old enough."""
        if self._checkpoint is None or time.monotonic() - self._written < checkpoints.SECONDS:
            return
        checkpoints.save(self._checkpoint, self._state(), self._mark)
        self._written = time.monotonic()

    def _state(self) -> checkpoints.State:
        best = self._best
        return {
            "done": self.done,
            "ended": self.ended,
            "losses": self.losses,
            "network": self.network.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "memory": self.memory,
            "added": None if self.added is None else torch.from_numpy(self.added),
            "best": None if best is None else {"residual": best.residual, "at": best.at, "weights": dict(best.weights)},
        }

    def _restore(self, state: checkpoints.State) -> None:
        self.done, self.ended, self.losses = state["done"], state["ended"], state["losses"]
        self.memory = state["memory"]
        self.network.load_state_dict(state["network"])
        self._optimiser.load_state_dict(state["optimiser"])
        self.added = None if state["added"] is None else state["added"].cpu().numpy()
        self._best = None if state["best"] is None else Best(**state["best"])


def learning_rate(step: int, config: NetworkConfig) -> float:
    """Learning rate of step 0, 1, … `total_steps` − 1. The warm start comes first, with a schedule of its own."""
    if step < config.warm_start:
        return config.learning_rate * warm_up_cosine(step, config.warm_start, WARM_START_RISE)
    return config.learning_rate * warm_up_cosine(step - config.warm_start, config.loss_steps, config.warm_up)
