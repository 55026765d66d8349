"""The state of one fit and the descent: what a checkpoint keeps, what a step changes, when it ends."""

from __future__ import annotations

import math
import time
from collections.abc import Generator, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor

from services.edge.arrays import DistanceFn, Floats
from services.edge.errors import EdgeError
from services.edge.field import checkpoint as checkpoints
from services.edge.field.compute import captured
from services.edge.field.config import FitConfig
from services.edge.field.learned import learned_field
from services.edge.field.losses import total_loss
from services.edge.field.networks import network_of
from services.edge.field.objectives import Objective
from services.edge.field.queries import Batches, Pool
from services.edge.field.schedule import learning_rate

EXPLODED = 10.0  # a loss above this, in unit frames: the pulled queries have left the box tenfold
PER_YIELD = {"cpu": 1, "cuda": 25}  # steps between two yields: reading the losses makes a GPU wait
RESIDUAL_EVERY = 50  # steps between two looks at the held-out points; a multiple of the above
BETTER = 0.99  # of the best residual: a hundredth is less than what two seeds differ by
UNCAPTURED = 3  # steps before the capture: allocators, cuBLAS and Adam's state settle

Made = TypeVar("Made")


@dataclass(frozen=True, slots=True)
class Step:
    """Where a fit stands: its number out of `of`, the losses by name, and the field of the weights as they stand."""

    number: int
    of: int
    losses: Mapping[str, float]
    field: DistanceFn


@dataclass(frozen=True, slots=True)
class Best:
    """The least residual on the held-out points, the step it was seen at, and the weights of then."""

    residual: float
    at: int
    weights: Mapping[str, Tensor]


class Run:
    """A fit between two steps.

    done     steps done;  ended  whether patience has ended the fit
    added    (K,3) points of the densification round, or None before it
    memory   ω (J,) of the pool in use, or None before its first loss
    """

    def __init__(
        self, xyz: Floats, config: FitConfig, device: torch.device, held_out: Floats | None, checkpoint: Path | None
    ) -> None:
        self.config, self.device, self.done, self.ended = config, device, 0, False
        self.network = network_of(config).to(device)
        self.added: Floats | None = None
        self.memory: Tensor | None = None
        self._best: Best | None = None
        # A tensor, for a captured step reads it from where it was; fused, for 30 small tensors are 30 launches else.
        self._rate = torch.tensor(config.learning_rate, device=device)
        self._optimiser = torch.optim.Adam(
            self.network.parameters(), lr=self._rate, fused=True, capturable=device.type == "cuda"
        )
        self._held_out = None if held_out is None else torch.as_tensor(held_out, dtype=torch.float32, device=device)
        self._field = learned_field(self.network, xyz)
        self._checkpoint = checkpoint
        self._mark = checkpoints.fingerprint(config, device, xyz, held_out)
        self._written = time.monotonic()
        if checkpoint and (state := checkpoints.load(checkpoint, self._mark, device)):
            self._restore(state)

    def step(self, losses: Mapping[str, float]) -> Step:
        """What the caller sees."""
        return Step(self.done, self.config.total_steps, losses, self._field)

    def waiting(self, work: Iterator[Made | None]) -> Generator[Step, None, Made]:
        """Work that yields None for a breath and its result last: the caller gets a step for every breath."""
        for made in work:
            if made is not None:
                return made
            yield self.step({})
        raise AssertionError("the work ended without a result")

    def memory_of(self, pool: Pool) -> Tensor:
        """ω of this pool: that of the checkpoint, or one that has seen nothing."""
        if self.memory is None:
            self.memory = torch.full((len(pool),), math.nan, device=self.device)
        return self.memory

    def densify_by(self, added: Floats) -> None:
        """The next pool is another: its queries have no memory."""
        self.added, self.memory = added, None

    def descend(
        self, objective: Objective, weights: Mapping[str, float], batches: Batches, until: int
    ) -> Iterator[Step]:
        """Steps up to the number `until`, unless patience ends them."""
        j = torch.zeros(batches.size, dtype=torch.int64, device=self.device)
        values = torch.zeros(1 + len(weights), device=self.device)

        def descent() -> None:
            self._optimiser.zero_grad(set_to_none=True)
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
            if self.done - start == UNCAPTURED:
                run = captured(descent, self.device)
            if self.done % PER_YIELD[self.device.type] == 0 or self.done == until:
                losses = dict(zip(("total", *weights), values.tolist(), strict=True))
                refuse_divergence(losses, EXPLODED, self.config, self.done)
                self._look_at_held_out()
                self._write()
                yield self.step(losses)

    def take_best(self) -> bool:
        """Go back to the weights that did best on the held-out points; whether there are such."""
        if self._best is None:
            return False
        self.network.load_state_dict(self._best.weights)
        return True

    @torch.no_grad()
    def _look_at_held_out(self) -> None:
        patience = self.config.patience
        if self._held_out is None or not patience or self.done % RESIDUAL_EVERY or self.done <= self.config.warm_start:
            return
        residual = float(self.network(self._held_out).mean())
        if self._best is None or residual < BETTER * self._best.residual:
            weights = {name: tensor.clone() for name, tensor in self.network.state_dict().items()}
            self._best = Best(residual, self.done, weights)
        self.ended = self.done - self._best.at >= patience

    def _write(self) -> None:
        if self._checkpoint is None or time.monotonic() - self._written < checkpoints.SECONDS:
            return
        checkpoints.save(self._checkpoint, self._state(), self._mark)
        self._written = time.monotonic()

    def _state(self) -> checkpoints.State:
        best = self._best
        return {
            "done": self.done,
            "ended": self.ended,
            "network": self.network.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "memory": self.memory,
            "added": None if self.added is None else torch.from_numpy(self.added),
            "best": None if best is None else {"residual": best.residual, "at": best.at, "weights": dict(best.weights)},
        }

    def _restore(self, state: checkpoints.State) -> None:
        self.done, self.ended, self.memory = state["done"], state["ended"], state["memory"]
        self.network.load_state_dict(state["network"])
        self._optimiser.load_state_dict(state["optimiser"])
        for group in self._optimiser.param_groups:
            group["lr"] = self._rate  # loading has put a copy in its place
        self.added = None if state["added"] is None else state["added"].cpu().numpy()
        self._best = None if state["best"] is None else Best(**state["best"])


def checked_points(xyz_unit: Floats, least: int) -> Floats:
    """The points (N,3) as float64. Raises ValueError for another shape or NaN, EdgeError for fewer than `least`."""
    xyz = np.ascontiguousarray(xyz_unit, np.float64)
    if xyz.ndim != 2 or xyz.shape[1] != 3:
        raise ValueError(f"a fit needs (N,3) points, not {xyz.shape}")
    if not np.isfinite(xyz).all():
        raise ValueError(f"{int((~np.isfinite(xyz)).any(axis=1).sum())} points are not finite")
    if len(xyz) < least:
        raise EdgeError(
            "FIT_TOO_FEW_POINTS",
            f"{len(xyz)} points are too few to fit a field to; it takes at least {least}",
            hints=("scan the thing again, closer", "keep the preview, which needs no fit"),
        )
    return xyz


def refuse_divergence(losses: Mapping[str, float], exploded: float, config: FitConfig, step: int) -> None:
    """Raises EdgeError FIT_DIVERGED where the total loss is NaN or above `exploded`."""
    if losses["total"] < exploded:  # false for NaN too
        return
    raise EdgeError(
        "FIT_DIVERGED",
        f"the fit diverged at step {step:,}: its loss is {losses['total']:.3g}",
        hints=(
            "keep the preview, which needs no fit",
            f"choose a preset with a learning rate below {config.learning_rate:g}",
            "look for points far away from the others",
        ),
    )
