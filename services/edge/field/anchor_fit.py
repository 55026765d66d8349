"""Points in, a field of trained anchors out: the product's own parametrisation of the unsigned distance.

1. the local field's patch at every point; where there is noise, at the denoised point     (patches.py, denoise.py)
2. noise only: short fits decide how far to trust the points                                   (trust.py)
3. train the patches until they agree with their neighbours                                    (agreement.py)
4. see anew who is a neighbour in the same layer, and train on

Every step sees all neighbours, so nothing is drawn at random but which points the short fits hold out. A step is a
gather and some sums over 8 to 10 edges a point: 30 ms for 10,000 points on one core, 0.36 s for 100,000.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from services.edge.arrays import DistanceFn, Floats, Ints
from services.edge.field import checkpoint as checkpoints
from services.edge.field import trust as trusts
from services.edge.field.agreement import (
    DISTANCE,
    FLATNESS,
    GRADIENT,
    LOOSE,
    NEIGHBOURS,
    TIGHT,
    Edges,
    Tolerance,
    agreement_losses,
    edges_between,
    flatness_loss,
    surface_loss,
)
from services.edge.field.anchors import SHAPE, AnchorField, Anchors, curved_anchors
from services.edge.field.compute import captured, memory_errors_named, open_device, side_by_side
from services.edge.field.config import FitConfig
from services.edge.field.denoise import denoise
from services.edge.field.folds import noise_of
from services.edge.field.local import LocalField, local_field
from services.edge.field.noise import Noise
from services.edge.field.run import PER_YIELD, UNCAPTURED, Step, checked_points, refuse_divergence
from services.edge.field.schedule import rise_and_fall
from services.edge.field.trust import CANDIDATES, Scan

LEAST_POINTS = 2 * NEIGHBOURS  # fewer than twice a patch's neighbours leave nothing that could agree
FIRST_SHARE = 0.5  # of the config's steps: the trials and the first round need the normals, not the last digit
MOMENTS = (0.9, 0.99)  # of Adam: the usual 0.999 remembers longer than a round lasts
BLOCK = {"cpu": 1 << 17, "cuda": 1 << 21}  # edges at once: the activations of one take some 300 bytes
LEAST_FREEDOM = 1e-3  # of an offset that was not free at all and is 0: keeps it from dividing by 0
EXPLODED = 1e3  # a loss above this: robust terms of anchors in their own spacings stay below 1
LOSSES = ("total", "agreement", "gradient", "surface", "flatness")


@dataclass(frozen=True, slots=True)
class Round:
    """One training: from which anchors, over which edges, towards what. Tensors are on the fit's device."""

    anchors: Anchors
    edges: Sequence[Edges]
    tolerance: Tolerance
    height: Tensor
    trust: Tensor
    free: Tensor
    steps: int


def fit_anchors(
    xyz_unit: Floats,
    config: FitConfig,
    *,
    device: str = "cpu",
    base: DistanceFn | None = None,
    noise: Noise | None = None,
    checkpoint: Path | None = None,
) -> Generator[Step, None, None]:
    """Train a field of anchors for points (N,3) in the unit frame, as they were scanned but without strays.

    base        the local field of the same points denoised, where the caller has it already
    noise       that of the points, likewise
    checkpoint  the file that keeps the fit's state: written every few seconds, and read if the fit was killed

    Of the config it takes `steps` and `learning_rate`. Whoever stops iterating ends the fit. The same points, config
    and device give the same field. The first steps, with the number 0 and no losses, are the set-up's.
    Raises EdgeError FIT_TOO_FEW_POINTS, FIT_DIVERGED, GPU_OOM, DEVICE_ABSENT, and ValueError for points that are not
    finite.
    """
    xyz = checked_points(xyz_unit, LEAST_POINTS)
    noise = noise or noise_of(xyz)
    start = base if isinstance(base, LocalField) else local_field(denoise(xyz, noise))
    if len(start.patches.xyz) != len(xyz):
        raise ValueError(f"a local field of {len(start.patches.xyz)} points is no base for {len(xyz)}")
    with memory_errors_named(f"the fit of {len(xyz):,} anchors"):
        fit = _AnchorFit(xyz, noise, config, open_device(device), start, checkpoint)
        yield from fit.prepare()
        yield from fit.rounds()


class _AnchorFit:
    """A fit between two steps: `finished` holds the shapes (N,6) that each round ended with, and the points, the config
    and those say what the next round is. A checkpoint therefore keeps them and the round at hand, nothing else."""

    def __init__(
        self,
        xyz: Floats,
        noise: Noise,
        config: FitConfig,
        device: torch.device,
        local: LocalField,
        checkpoint: Path | None,
    ) -> None:
        self._xyz, self._noise, self._config, self._device, self._checkpoint = xyz, noise, config, device, checkpoint
        self._local = local
        self._start = curved_anchors(local.patches)
        self._first = max(1, round(FIRST_SHARE * config.steps))
        self._mark = checkpoints.fingerprint(config, device, xyz, local.patches.xyz)
        self._written = time.monotonic()
        self._finished: list[Tensor] = []
        self._state: checkpoints.State | None = None
        if checkpoint and (state := checkpoints.load(checkpoint, self._mark, device)):
            self._finished, self._state = state["finished"], state["round"]

    def prepare(self) -> Iterator[Step]:
        """What the rounds need to know of the points; a step after each second or two of it, for who wants to stop."""
        waiting = Step(0, self._first + self._config.steps, {}, self._local)
        yield waiting
        self._noisy = bool(self._noise.share.any())
        self._judges = trusts.judges(self._xyz) if self._noisy else np.empty(0, np.int64)
        self._trials = len(CANDIDATES) if self._noisy else 0
        self._of = (self._trials + 1) * self._first + self._config.steps
        self._neighbours: Ints = self._local.tree.query(self._local.patches.xyz, k=NEIGHBOURS + 1, workers=-1)[1]
        yield waiting

    def rounds(self) -> Iterator[Step]:
        """All steps."""
        while len(self._finished) < self._trials + 2:
            current = self._next_round()
            shape = yield from self._train(current)
            self._finished.append(shape)

    def _next_round(self) -> Round:
        number = len(self._finished)
        if number < self._trials:
            return self._trial(CANDIDATES[number])
        weight = self._chosen() if self._noisy else None
        scan = trusts.scan_of(self._xyz, self._noise, self._start)
        scan = scan if weight else scan.ignored()
        anchors, steps = self._start, self._first
        if number > self._trials:
            anchors, steps = replace(anchors, shape=self._finished[-1].cpu().numpy()), self._config.steps
        return self._round(anchors, self._neighbours, scan, scan.trust(weight or 0.0), TIGHT, steps)

    def _trial(self, weight: float) -> Round:
        """The short fit of a candidate, which does not see the held-out points."""
        part = self._judges
        # Flat, for the curvatures that the denoised points gave know of the held-out ones.
        start = self._start
        flat = np.zeros_like(start.terms[part]), np.zeros_like(start.shape[part])
        anchors = Anchors(start.xyz[part], start.frame[part], start.spacing[part], *flat)
        scan = trusts.scan_of(self._xyz, self._noise, self._start).of(part)
        trust = np.where(trusts.held_out(len(part)), 0, scan.trust(weight))
        _, neighbours = cKDTree(anchors.xyz).query(anchors.xyz, k=NEIGHBOURS + 1)
        return self._round(anchors, neighbours, scan, trust, LOOSE, self._first)

    def _chosen(self) -> float | None:
        """μ by the errors of the trials, None for the denoised points as they are."""
        part = self._judges
        scan = trusts.scan_of(self._xyz, self._noise, self._start).of(part)
        judged = np.flatnonzero(trusts.held_out(len(part)) & scan.told)
        found = [trusts.errors(shape[:, 0].cpu().numpy(), scan)[judged] for shape in self._finished[: self._trials]]
        return trusts.chosen(found)

    def _round(
        self, anchors: Anchors, neighbours: Ints, scan: Scan, trust: Floats, tolerance: Tolerance, steps: int
    ) -> Round:
        def tensor(array: Floats) -> Tensor:
            return torch.as_tensor(array, dtype=torch.float32, device=self._device)

        free = np.ones((len(anchors.xyz), SHAPE))
        free[:, 0] = scan.freedom
        edges = edges_between(anchors, neighbours, tolerance, self._device)
        return Round(
            anchors,
            edges.parts(_block(edges, self._device)),
            tolerance,
            tensor(scan.height - anchors.terms[:, 0]),  # the height of the base at its own point
            tensor(trust),
            tensor(free),
            steps,
        )

    def _train(self, current: Round) -> Generator[Step, None, Tensor]:
        """The steps of one round; returns the shapes it ends with."""
        # What is trained is the shape before its offset's share of freedom.
        shape = torch.as_tensor(current.anchors.shape, device=self._device) / current.free.clamp_min(LEAST_FREEDOM)
        shape.requires_grad_()
        # A tensor, for a captured step reads it from where it was.
        rate = torch.tensor(self._config.learning_rate, device=self._device)
        cuda = self._device.type == "cuda"
        optimiser = torch.optim.Adam([shape], lr=rate, betas=MOMENTS, fused=True, capturable=cuda)
        done = self._resume(shape, optimiser, rate)
        if done == current.steps:  # killed behind its last step: whoever looks at the last one must see this field
            yield self._step(done, {}, current, shape)
        values = torch.zeros(len(LOSSES), device=self._device)

        def descent() -> None:
            optimiser.zero_grad(set_to_none=True)
            values.copy_(_descend(shape, current))
            optimiser.step()

        run, start = descent, done
        while done < current.steps:
            rate.fill_(self._config.learning_rate * rise_and_fall(done, current.steps, current.steps))
            run()
            done += 1
            if done - start == UNCAPTURED:
                run = captured(descent, self._device)
            if done % PER_YIELD[self._device.type] == 0 or done == current.steps:
                losses = dict(zip(LOSSES, values.tolist(), strict=True))
                refuse_divergence(losses, EXPLODED, self._config, done)
                self._write(shape, optimiser, done)
                yield self._step(done, losses, current, shape)
        return (shape * current.free).detach()

    def _step(self, done: int, losses: Mapping[str, float], current: Round, shape: Tensor) -> Step:
        """What the caller sees. A trial's anchors may be a part of all: its field is that which the fit starts from."""
        number = len(self._finished)
        before = min(number, self._trials + 1) * self._first
        anchors = self._start
        if number >= self._trials:
            anchors = replace(current.anchors, shape=(shape * current.free).detach().cpu().numpy().copy())
        return Step(before + done, self._of, losses, AnchorField(anchors))

    def _write(self, shape: Tensor, optimiser: torch.optim.Adam, done: int) -> None:
        if self._checkpoint is None or time.monotonic() - self._written < checkpoints.SECONDS:
            return
        at_hand = {"shape": shape.detach(), "optimiser": optimiser.state_dict(), "done": done}
        checkpoints.save(self._checkpoint, {"finished": self._finished, "round": at_hand}, self._mark)
        self._written = time.monotonic()

    def _resume(self, shape: Tensor, optimiser: torch.optim.Adam, rate: Tensor) -> int:
        """Take up the round that a checkpoint was written in, if one was read; the steps of it that are done."""
        if self._state is None:
            return 0
        state, self._state = self._state, None
        with torch.no_grad():
            shape.copy_(state["shape"])
        optimiser.load_state_dict(state["optimiser"])
        for group in optimiser.param_groups:
            group["lr"] = rate  # loading has put a copy in its place
        return int(state["done"])


def _descend(shape: Tensor, current: Round) -> Tensor:
    """Add the gradients of all losses to the shape's, block by block; the losses, as `LOSSES` names them."""

    def descend(block: Edges) -> tuple[Tensor, Tensor, Tensor]:
        own = shape.detach().requires_grad_()
        of_distance, of_gradient = agreement_losses(own * current.free, block, current.tolerance)
        slope = torch.autograd.grad(DISTANCE * of_distance + GRADIENT * of_gradient, own)[0]
        return of_distance.detach(), of_gradient.detach(), slope

    agreement, gradient = shape.new_zeros(()), shape.new_zeros(())
    shape.grad = torch.zeros_like(shape)
    # Summed in the order of the blocks, whichever thread is done first: fits must repeat.
    for of_distance, of_gradient, slope in side_by_side(descend, current.edges, shape.device):
        agreement, gradient = agreement + of_distance, gradient + of_gradient
        shape.grad += slope
    surface = surface_loss(shape[:, 0] * current.free[:, 0], current.height, current.trust)
    flatness = flatness_loss(shape)
    (surface + FLATNESS * flatness).backward()  # type: ignore[no-untyped-call]
    total = DISTANCE * agreement + GRADIENT * gradient + surface.detach() + FLATNESS * flatness.detach()
    return torch.stack([total, agreement, gradient, surface.detach(), flatness.detach()])


def _block(edges: Edges, device: torch.device) -> int:
    """Edges a block: on a CPU at least four blocks, which threads can share."""
    count = len(edges.first)
    return min(BLOCK[device.type], -(-count // 4) if device.type == "cpu" else count) or 1
