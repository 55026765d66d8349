"""Train a head: one loop with checkpoints, and half-precision weights at the end.

The learning rate warms up, stays, and falls to 0 in the last fifth of the steps (Hu et al. 2024, MiniCPM: warm-up,
stable, decay). It begins to fall once the held-out Chamfer distance is flat, or in time for the most steps allowed; so
nobody must know beforehand how many steps a head needs.

A step's batch depends on the seed and the step's number alone. So a killed training resumes from its checkpoint, and on
the CPU ends with the same weights as an uninterrupted one.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional

from capture2vr.edge.field import checkpoint
from tests.bench.single_photo_network.camera import about_vertical, project
from tests.bench.single_photo_network.network import POINTS, Pixels, bin_of
from tests.bench.single_photo_training.batches import Batch, training_batches
from tests.bench.single_photo_training.evaluate import evaluate_head
from tests.bench.single_photo_training.field_heads import Field, value_and_gradient
from tests.bench.single_photo_training.losses import chamfer_loss, nearest, udf_loss
from tests.bench.single_photo_training.real_things import RealThing
from tests.bench.single_photo_training.weight_files import TrainingRecord, new_head, save_half

_RATE = 5e-4  # highest learning rate of AdamW; at 1e-3 the figures did not improve
_WARM = 300  # steps of linear warm-up
_BETAS = (0.9, 0.99)  # of AdamW: a short average of the squares, for a short training
_DECAY = 0.01  # weight decay
_CHECKPOINT_S = 30.0  # seconds between checkpoints
_REPORT_STEPS = 100  # between lines of progress
_EVALUATE_STEPS = 1000  # between evaluations on held-out shapes
_PATIENCE = 4  # evaluations in a row without a gain after which the held-out distance is flat
_GAIN = 0.01  # least gain, of the best distance so far: evaluations differ by about as much by chance
_FALLING = 0.25  # steps over which the learning rate falls, of those before
_CAMERA = 0.05  # weight of the camera's error, in half pictures, beside (2) of `losses.py`
_YAW = 0.03  # weight of the cross-entropy of the yaw, which begins at 3.6
_FIRST = 0.5  # weight of the points before they are refined
_TRUE_YAW = 0.5  # share of a batch that is rotated by the true yaw
_QUERIES = 256  # per picture
_BANDS = (0.02, 0.06, 0.15)  # standard deviations of the queries' distances from the surface; a seventh are anywhere


@dataclass(frozen=True, slots=True)
class HeadTraining:
    """Settings of a training: everything that the result depends on, except the backbone of a field.

    steps   the most steps; fewer where the held-out distance is flat before
    meshes  fingerprint of the real things that are trained on too, or ""
    """

    head: str
    steps: int
    seed: int = 0
    meshes: str = ""


SHIPPED = (HeadTraining("pixels", 20_000), HeadTraining("anchor-udf", 20_000), HeadTraining("implicit", 30_000))
"""Trainings that give all weight files, in this order: `pixels` is the backbone of the fields. At most four hours of
one core each."""


@dataclass(slots=True)
class _Schedule:
    """Where a training stands: the held-out distances so far, and the step from which the rate falls; 0: not yet."""

    most: int
    distances: list[float] = field(default_factory=list)
    falls_from: int = 0

    @property
    def end(self) -> int:
        """The number of steps that the training takes, as far as that is known."""
        return self._end(self.falls_from) if self.falls_from else self.most

    def advance(self, step: int, distance: float | None) -> None:
        """Note the held-out distance after a step, if it was evaluated, and begin to fall when it is time."""
        if distance is not None:
            self.distances.append(distance)
        if not self.falls_from and (self._is_flat() or self._end(step) >= self.most):
            self.falls_from = step

    def rate_share(self, step: int) -> float:
        """Learning rate of a step over the highest."""
        return rate_share(step, self.falls_from, self.end)

    def _end(self, falls_from: int) -> int:
        return min(self.most, math.ceil(falls_from * (1 + _FALLING)))

    def _is_flat(self) -> bool:
        before, latest = self.distances[:-_PATIENCE], self.distances[-_PATIENCE:]
        return bool(before) and min(latest) > (1 - _GAIN) * min(before)


def train(
    training: HeadTraining,
    folder: Path,
    device: torch.device,
    *,
    things: Sequence[RealThing] = (),
    report: Callable[[str], None] = print,
) -> nn.Module:
    """Train a head, or resume its training. Returns the trained head, and writes it to HEAD.pt in `folder`.

    things  real ones, which every other picture shows; `training.meshes` is their fingerprint
    """
    torch.manual_seed(training.seed)
    head: nn.Module = new_head(training.head, folder).to(device=device, memory_format=torch.channels_last)  # type: ignore[call-overload]
    trainable = [each for each in head.parameters() if each.requires_grad]
    optimiser = torch.optim.AdamW(trainable, lr=_RATE, betas=_BETAS, weight_decay=_DECAY)
    path, mark = folder / f"{training.head}.checkpoint", f"{training!r} {device.type}"
    step, spent, schedule = _restore(path, mark, device, head, optimiser, training.steps)
    seconds = spent
    began = saved = time.monotonic()
    for batch in training_batches(training.seed, step, things):
        if step >= schedule.end:
            break
        loss = _train_step(head, optimiser, batch.to(device), training, step, schedule.rate_share(step))
        step += 1
        seconds = spent + time.monotonic() - began
        evaluated = evaluate_head(head, device) if step % _EVALUATE_STEPS == 0 else None
        schedule.advance(step, evaluated.chamfer if evaluated else None)
        if step % _REPORT_STEPS == 0 or step == schedule.end:
            left = (schedule.end - step) * seconds / step
            report(f"step {step}/{schedule.end}  loss {loss.item():.4f}  {seconds:.0f} s, {left:.0f} s left")
        if evaluated:
            report(f"step {step}: {evaluated}")
        if time.monotonic() - saved > _CHECKPOINT_S or step == schedule.end:
            saved = time.monotonic()
            checkpoint.save(path, _state(head, optimiser, step, seconds, schedule), mark)
    save_half(head, TrainingRecord(step, round(seconds, 1)), folder / f"{training.head}.pt")
    return head


def rate_share(step: int, falls_from: int, end: int) -> float:
    """Learning rate of a step over the highest: a linear warm-up, then 1, then a linear fall to 0 at the end."""
    falling = (end - step) / max(1, end - falls_from) if falls_from else 1.0
    return min(1.0, (step + 1) / _WARM, falling)


def pixels_loss(head: Pixels, batch: Batch) -> Tensor:
    """Loss of `pixels` on a batch: of the points before and after they are refined, the yaw and the camera.

    Half of the things are rotated by the true yaw, half by the predicted one, so that its errors are learned too.
    """
    true_yaw = torch.where(torch.rand(len(batch.yaw)).to(batch.yaw.device) < _TRUE_YAW, batch.yaw, torch.nan)
    with _autocast(batch.picture.device):
        prediction = head(batch.picture, true_yaw)
    surface = batch.surface[:, torch.randperm(batch.surface.shape[1])[:POINTS]]
    some = batch.surface[:, :64]
    off = (project(some, prediction.camera)[0] - project(some, batch.camera)[0]).abs().mean()
    turned = functional.cross_entropy(prediction.bins, bin_of(batch.yaw))
    first = chamfer_loss(prediction.own, about_vertical(surface, -batch.yaw))
    return chamfer_loss(prediction.points, surface) + _FIRST * first + _CAMERA * off + _YAW * turned


def field_loss(head: Field, batch: Batch) -> Tensor:
    """Loss of a field on a batch: of distances and gradient directions at queries around the surface."""
    with _autocast(batch.picture.device):
        prediction = head.encode(batch.picture)
    q = _queries(batch.surface)
    to_surface, _ = nearest(q, batch.surface)
    away = q - batch.surface.gather(1, to_surface[..., None].expand(-1, -1, 3))
    true_distance = away.norm(dim=2)
    distance, gradient = value_and_gradient(head, prediction, q, learn=True)
    return udf_loss(distance, gradient, true_distance, away / true_distance.clamp(min=1e-6)[..., None])


def _queries(surface: Tensor) -> Tensor:
    """Random queries (n,_QUERIES,3): most around points of the surface, a seventh anywhere."""
    n = len(surface)
    q = surface[:, torch.randperm(surface.shape[1])[:_QUERIES]].clone()
    band = torch.tensor(_BANDS)[torch.randint(len(_BANDS), (n, _QUERIES, 1))]
    q += (band * torch.randn(n, _QUERIES, 3)).to(q.device)
    q[:, ::7] = 2 * torch.rand(n, q[:, ::7].shape[1], 3).to(q.device) - 1
    return q


def _train_step(
    head: nn.Module,
    optimiser: torch.optim.Optimizer,
    batch: Batch,
    training: HeadTraining,
    step: int,
    share: float,
) -> Tensor:
    """Run one optimiser step on a batch, at a share of the learning rate; returns its loss."""
    torch.manual_seed((training.seed << 24) + step)
    for group in optimiser.param_groups:
        group["lr"] = _RATE * share
    head.train()
    loss = pixels_loss(head, batch) if isinstance(head, Pixels) else field_loss(head, batch)  # type: ignore[arg-type]
    optimiser.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    nn.utils.clip_grad_norm_(head.parameters(), 1.0)
    optimiser.step()
    return loss.detach()


def _state(
    head: nn.Module, optimiser: torch.optim.Optimizer, step: int, seconds: float, schedule: _Schedule
) -> checkpoint.State:
    return {
        "head": head.state_dict(),
        "optimiser": optimiser.state_dict(),
        "step": step,
        "seconds": seconds,
        "distances": schedule.distances,
        "falls_from": schedule.falls_from,
    }


def _restore(
    path: Path, mark: str, device: torch.device, head: nn.Module, optimiser: torch.optim.Optimizer, most: int
) -> tuple[int, float, _Schedule]:
    """Restore head and optimiser from the checkpoint, if there is one -> steps done, their seconds, the schedule."""
    state = checkpoint.load(path, mark, device)
    if state is None:
        return 0, 0.0, _Schedule(most)
    head.load_state_dict(state["head"])
    optimiser.load_state_dict(state["optimiser"])
    return int(state["step"]), float(state["seconds"]), _Schedule(most, state["distances"], state["falls_from"])


def _autocast(device: torch.device) -> torch.autocast:
    """Use bfloat16 where it is fast: on a GPU, and on a CPU that can multiply it."""
    fast = device.type == "cuda" or bool(torch.ops.mkldnn._is_mkldnn_bf16_supported())
    return torch.autocast(device.type, torch.bfloat16, enabled=fast)
