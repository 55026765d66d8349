"""Train the product's unsigned distance field: one curved patch (anchor) at every point.

1. fit the local field's patch at every point; where there is noise, at the denoised point  (patches.py, denoise.py)
2. noise only: short trial fits decide how far to trust the points                              (noise_trust.py)
3. train the patches until they agree with their neighbours                                    (anchor_losses.py)
4. find the neighbours in the same layer again, now by the trained patches, and train on

Every step uses all pairs of neighbours, so the only random choice is which points the trial fits hold out. A step is
a gather and some sums over 8 to 10 edges per point: 30 ms for 10,000 points on one core, 0.36 s for 100,000.
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

from capture2vr.edge.arrays import DistanceFn, Floats, Ints
from capture2vr.edge.field import checkpoint as checkpoints
from capture2vr.edge.field import noise_trust
from capture2vr.edge.field.adam import Adam
from capture2vr.edge.field.anchor_losses import (
    DISTANCE,
    FLATNESS,
    GRADIENT,
    LOOSE,
    NEIGHBOURS,
    TIGHT,
    AnchorEdges,
    Tolerance,
    agreement_losses,
    edges_between,
    flatness_loss,
    surface_loss,
)
from capture2vr.edge.field.anchors import SHAPE, AnchorField, Anchors, curved_anchors
from capture2vr.edge.field.compute import capture_step, map_blocks, open_device, translate_memory_errors
from capture2vr.edge.field.config import AnchorConfig
from capture2vr.edge.field.denoise import denoise
from capture2vr.edge.field.folds import noise_of
from capture2vr.edge.field.local import LocalField, local_field
from capture2vr.edge.field.noise import Noise
from capture2vr.edge.field.noise_trust import CANDIDATES, Scan
from capture2vr.edge.field.schedule import warm_up_cosine
from capture2vr.edge.field.step import PER_YIELD, STEPS_BEFORE_CAPTURE, Step, check_points, refuse_divergence

LEAST_POINTS = 2 * NEIGHBOURS  # in a smaller cloud all patches share their neighbours, and none could agree
FIRST_SHARE = 0.5  # of the config's steps, for each trial and the first round: they need no more than good normals
MOMENTS = (0.9, 0.99)  # Adam's betas: the usual 0.999 averages over more steps than a round has
BLOCK = {"cpu": 1 << 17, "cuda": 1 << 21}  # most edges per block: the activations of an edge take some 300 bytes
LEAST_FREEDOM = 1e-3  # in place of a freedom of 0, where the offset is 0 too: avoids a division by 0
EXPLODED = 1e3  # total loss above which a fit has diverged: robust terms, in spacings, stay below 1
LOSSES = ("total", "agreement", "gradient", "surface", "flatness")  # in the order of `_losses_and_gradient`


@dataclass(frozen=True, slots=True)
class TrainingRound:
    """Input of one training round. Tensors are on the fit's device.

    height, trust  (N,) the surface term: where each point was scanned above its base, in spacings, and μ/σ²
    free           (N,6) share of its trained value that each number of a shape may use
    """

    anchors: Anchors
    edges: Sequence[AnchorEdges]
    tolerance: Tolerance
    height: Tensor
    trust: Tensor
    free: Tensor
    steps: int


def fit_anchors(
    xyz_unit: Floats,
    config: AnchorConfig,
    *,
    device: str = "cpu",
    base: DistanceFn | None = None,
    noise: Noise | None = None,
    checkpoint: Path | None = None,
) -> Generator[Step, None, None]:
    """Train a field of anchors for points (N,3) in the unit frame, as they were scanned, without outliers.

    base        the local field of the same points denoised, where the caller has it already
    noise       the noise of the points, where the caller has it already
    checkpoint  file of the fit's state: written every few seconds, and read when a killed fit is started again

    Stop iterating to end the fit. The same points, config and device give the same field. The set-up yields the first
    steps, which have the number 0 and no losses.
    Raises EdgeError FIT_TOO_FEW_POINTS, FIT_DIVERGED, GPU_OOM, DEVICE_ABSENT, and ValueError for points that are not
    finite.
    """
    xyz = check_points(xyz_unit, LEAST_POINTS)
    noise = noise or noise_of(xyz)
    start = base if isinstance(base, LocalField) else local_field(denoise(xyz, noise))
    if len(start.patches.xyz) != len(xyz):
        raise ValueError(f"the base is a local field of {len(start.patches.xyz)} points, the fit has {len(xyz)} points")
    with translate_memory_errors(f"the fit of {len(xyz):,} anchors"):
        fit = _AnchorFit(xyz, noise, config, open_device(device), start, checkpoint)
        yield from fit.prepare()
        yield from fit.rounds()


class _AnchorFit:
    """The state of a fit: `finished` holds the shapes (N,6) at the end of each round.

    They, the points and the config determine the next round, so a checkpoint holds only them and the current round.
    """

    def __init__(
        self,
        xyz: Floats,
        noise: Noise,
        config: AnchorConfig,
        device: torch.device,
        local: LocalField,
        checkpoint: Path | None,
    ) -> None:
        self._xyz, self._noise, self._config, self._device, self._checkpoint = xyz, noise, config, device, checkpoint
        self._local = local
        self._start = curved_anchors(local.patches)
        self._first_steps = max(1, round(FIRST_SHARE * config.steps))
        self._fingerprint = checkpoints.fingerprint(config, device, xyz, local.patches.xyz)
        self._written = time.monotonic()
        self._finished: list[Tensor] = []
        self._state: checkpoints.State | None = None
        if checkpoint and (state := checkpoints.load(checkpoint, self._fingerprint, device)):
            self._finished, self._state = state["finished"], state["round"]

    def prepare(self) -> Iterator[Step]:
        """Compute what the rounds need, yielding a step every second or two so that the caller can stop."""
        setup = Step(0, self._first_steps + self._config.steps, {}, self._local)
        yield setup
        self._noisy = bool(self._noise.share.any())
        self._trial_points = noise_trust.trial_points(self._xyz) if self._noisy else np.empty(0, np.int64)
        self._trials = len(CANDIDATES) if self._noisy else 0
        self._total_steps = (self._trials + 1) * self._first_steps + self._config.steps
        self._neighbours: Ints = self._local.tree.query(self._local.patches.xyz, k=NEIGHBOURS + 1, workers=-1)[1]
        yield setup

    def rounds(self) -> Iterator[Step]:
        """Run all rounds, yielding their steps."""
        while len(self._finished) < self._trials + 2:
            current = self._next_round()
            shape = yield from self._train(current)
            self._finished.append(shape)

    def _next_round(self) -> TrainingRound:
        """Build the round after the finished ones: the trials, then the first and the last round of all anchors."""
        number = len(self._finished)
        if number < self._trials:
            return self._trial(CANDIDATES[number])
        weight = self._choose_weight() if self._noisy else None
        scan = noise_trust.scan_of(self._xyz, self._noise, self._start)
        scan = scan if weight else scan.without_trust()
        anchors, steps = self._start, self._first_steps
        if number > self._trials:
            anchors, steps = replace(anchors, shape=self._finished[-1].cpu().numpy()), self._config.steps
        return self._build_round(anchors, self._neighbours, scan, scan.trust(weight or 0.0), TIGHT, steps)

    def _trial(self, weight: float) -> TrainingRound:
        """Build the trial fit of a candidate weight μ, which does not see the held-out points."""
        part = self._trial_points
        # Flat patches: curvatures from the denoised points would let the held-out points in.
        start = self._start
        flat = np.zeros_like(start.terms[part]), np.zeros_like(start.shape[part])
        anchors = Anchors(start.xyz[part], start.frame[part], start.spacing[part], *flat)
        scan = noise_trust.scan_of(self._xyz, self._noise, self._start).subset(part)
        trust = np.where(noise_trust.held_out_mask(len(part)), 0, scan.trust(weight))
        _, neighbours = cKDTree(anchors.xyz).query(anchors.xyz, k=NEIGHBOURS + 1)
        return self._build_round(anchors, neighbours, scan, trust, LOOSE, self._first_steps)

    def _choose_weight(self) -> float | None:
        """Choose μ by the trials' errors at the held-out points; None keeps the denoised points as they are."""
        part = self._trial_points
        scan = noise_trust.scan_of(self._xyz, self._noise, self._start).subset(part)
        tested = np.flatnonzero(noise_trust.held_out_mask(len(part)) & scan.usable)
        offsets = [shape[:, 0].cpu().numpy() for shape in self._finished[: self._trials]]
        return noise_trust.choose_trust([noise_trust.squared_errors(offset, scan)[tested] for offset in offsets])

    def _build_round(
        self, anchors: Anchors, neighbours: Ints, scan: Scan, trust: Floats, tolerance: Tolerance, steps: int
    ) -> TrainingRound:
        def tensor(array: Floats) -> Tensor:
            return torch.as_tensor(array, dtype=torch.float32, device=self._device)

        free = np.ones((len(anchors.xyz), SHAPE))
        free[:, 0] = scan.freedom
        edges = edges_between(anchors, neighbours, tolerance, self._device)
        return TrainingRound(
            anchors,
            edges.parts(_block_size(edges, self._device)),
            tolerance,
            tensor(scan.height - anchors.terms[:, 0]),  # the height of the base at its own point
            tensor(trust),
            tensor(free),
            steps,
        )

    def _train(self, current: TrainingRound) -> Generator[Step, None, Tensor]:
        """Run the steps of one round, from the checkpoint where there is one; returns the shapes at its end."""
        # What is trained is the shape divided by `free`, so that `free` scales how far each offset can move.
        shape = torch.as_tensor(current.anchors.shape, device=self._device) / current.free.clamp_min(LEAST_FREEDOM)
        shape.requires_grad_()
        # A tensor, because a captured CUDA graph reads it from a fixed address.
        rate = torch.tensor(self._config.learning_rate, device=self._device)
        optimiser = Adam([shape], rate, MOMENTS)
        done, losses = self._restore(shape, optimiser)
        if done == current.steps:  # killed after its last step: yield it again, so that the caller gets this field
            yield self._step(done, losses, current, shape)
        values = torch.zeros(len(LOSSES), device=self._device)

        def descent() -> None:
            optimiser.zero_grad()
            values.copy_(_losses_and_gradient(shape, current))
            optimiser.step()

        run, start = descent, done
        while done < current.steps:
            rate.fill_(self._config.learning_rate * warm_up_cosine(done, current.steps, current.steps))
            run()
            done += 1
            if done - start == STEPS_BEFORE_CAPTURE:
                run = capture_step(descent, self._device)
            if done % PER_YIELD[self._device.type] == 0 or done == current.steps:
                losses = dict(zip(LOSSES, values.tolist(), strict=True))
                refuse_divergence(losses, EXPLODED, self._config.learning_rate, done)
                self._write(shape, optimiser, done, losses)
                yield self._step(done, losses, current, shape)
        return (shape * current.free).detach()

    def _step(self, done: int, losses: Mapping[str, float], current: TrainingRound, shape: Tensor) -> Step:
        """Build the step for the caller. In a trial its field is the initial one: a trial may use only some anchors."""
        number = len(self._finished)
        before = min(number, self._trials + 1) * self._first_steps
        anchors = self._start
        if number >= self._trials:
            anchors = replace(current.anchors, shape=(shape * current.free).detach().cpu().numpy().copy())
        return Step(before + done, self._total_steps, losses, AnchorField(anchors))

    def _write(self, shape: Tensor, optimiser: Adam, done: int, losses: Mapping[str, float]) -> None:
        """Write the checkpoint, if the last one is old enough."""
        if self._checkpoint is None or time.monotonic() - self._written < checkpoints.SECONDS:
            return
        current = {"shape": shape.detach(), "optimiser": optimiser.state_dict(), "done": done, "losses": losses}
        checkpoints.save(self._checkpoint, {"finished": self._finished, "round": current}, self._fingerprint)
        self._written = time.monotonic()

    def _restore(self, shape: Tensor, optimiser: Adam) -> tuple[int, Mapping[str, float]]:
        """Restore the round from the checkpoint, if one was read. Returns its steps done and their last losses."""
        if self._state is None:
            return 0, {}
        state, self._state = self._state, None
        with torch.no_grad():
            shape.copy_(state["shape"])
        optimiser.load_state_dict(state["optimiser"])
        return int(state["done"]), state["losses"]


def _losses_and_gradient(shape: Tensor, current: TrainingRound) -> Tensor:
    """Return the losses in the order of `LOSSES`, and set `shape.grad` to their gradient, block by block."""

    def of_block(block: AnchorEdges) -> tuple[Tensor, Tensor, Tensor]:
        leaf = shape.detach().requires_grad_()
        of_distance, of_gradient = agreement_losses(leaf * current.free, block, current.tolerance)
        slope = torch.autograd.grad(DISTANCE * of_distance + GRADIENT * of_gradient, leaf)[0]
        return of_distance.detach(), of_gradient.detach(), slope

    agreement, gradient = shape.new_zeros(()), shape.new_zeros(())
    shape.grad = torch.zeros_like(shape)
    # Summed in the order of the blocks, whichever thread ends first: the same fit must give the same result.
    for of_distance, of_gradient, slope in map_blocks(of_block, current.edges, shape.device):
        agreement, gradient = agreement + of_distance, gradient + of_gradient
        shape.grad += slope
    surface = surface_loss(shape[:, 0] * current.free[:, 0], current.height, current.trust)
    flatness = flatness_loss(shape)
    (surface + FLATNESS * flatness).backward()  # type: ignore[no-untyped-call]
    total = DISTANCE * agreement + GRADIENT * gradient + surface.detach() + FLATNESS * flatness.detach()
    return torch.stack([total, agreement, gradient, surface.detach(), flatness.detach()])


def _block_size(edges: AnchorEdges, device: torch.device) -> int:
    """Edges per block: on a CPU few enough for at least four blocks, which threads can share."""
    count = len(edges.first)
    return min(BLOCK[device.type], -(-count // 4) if device.type == "cpu" else count) or 1
