"""Train a head: one loop with checkpoints, and half-precision weights at the end.

A step's batch depends on the seed and the step's number alone. So a killed training resumes from its checkpoint, and on
the CPU ends with the same weights as an uninterrupted one.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional

from services.edge.field import checkpoint
from services.edge.single_photo.camera import about_vertical, project
from services.edge.single_photo.network import POINTS, Pixels, bin_of
from services.edge.single_photo.weights import load_pixels
from services.edge.single_photo_training.batches import Batch, training_batches
from services.edge.single_photo_training.evaluate import evaluate_head
from services.edge.single_photo_training.field_heads import Field, value_and_gradient
from services.edge.single_photo_training.losses import chamfer_loss, nearest, udf_loss
from services.edge.single_photo_training.weight_files import TrainingRecord, load_field, new_head, save_half

_RATE = 5e-4  # highest learning rate of AdamW; at 1e-3 the figures did not improve
_WARM = 300  # steps of linear warm-up
_BETAS = (0.9, 0.99)  # of AdamW: a short average of the squares, for a short training
_DECAY = 0.01  # weight decay
_CHECKPOINT_S = 30.0  # seconds between checkpoints
_REPORT_STEPS = 100  # between lines of progress
_EVALUATE_STEPS = 2000  # between evaluations on held-out shapes
_CAMERA = 0.05  # weight of the camera's error, in half pictures, beside (2) of `losses.py`
_YAW = 0.03  # weight of the cross-entropy of the yaw, which begins at 3.6
_FIRST = 0.5  # weight of the points before they are refined
_TRUE_YAW = 0.5  # share of a batch that is rotated by the true yaw
_QUERIES = 256  # per picture
_BANDS = (0.02, 0.06, 0.15)  # standard deviations of the queries' distances from the surface; a seventh are anywhere


@dataclass(frozen=True, slots=True)
class HeadTraining:
    """Settings of a training: everything that the result depends on, except the backbone of a field.

    start: folder of trained weights to begin from, or "" for random ones.
    """

    head: str
    steps: int
    seed: int = 0
    start: str = ""


def train(
    training: HeadTraining, folder: Path, device: torch.device, *, report: Callable[[str], None] = print
) -> nn.Module:
    """Train a head, or resume its training. Returns the trained head, and writes it to HEAD.pt in `folder`."""
    torch.manual_seed(training.seed)
    head: nn.Module = _initial_head(training, folder).to(device=device, memory_format=torch.channels_last)  # type: ignore[call-overload]
    trainable = [each for each in head.parameters() if each.requires_grad]
    optimiser = torch.optim.AdamW(trainable, lr=_RATE, betas=_BETAS, weight_decay=_DECAY)
    path, mark = folder / f"{training.head}.checkpoint", f"{training!r} {device.type}"
    step, spent = _restore(path, mark, device, head, optimiser)
    seconds = spent
    began = saved = time.monotonic()
    for batch in training_batches(training.seed, step):
        if step >= training.steps:
            break
        loss = _train_step(head, optimiser, batch.to(device), training, step)
        step += 1
        seconds = spent + time.monotonic() - began
        if step % _REPORT_STEPS == 0 or step == training.steps:
            left = (training.steps - step) * seconds / step
            report(f"step {step}/{training.steps}  loss {loss.item():.4f}  {seconds:.0f} s, {left:.0f} s left")
        if step % _EVALUATE_STEPS == 0:
            report(f"step {step}: {evaluate_head(head, device)}")
        if time.monotonic() - saved > _CHECKPOINT_S or step == training.steps:
            saved = time.monotonic()
            checkpoint.save(path, _state(head, optimiser, step, seconds), mark)
    save_half(head, TrainingRecord(step, round(seconds, 1)), folder / f"{training.head}.pt")
    return head


def rate_share(step: int, steps: int) -> float:
    """Learning rate of a step over the highest: a linear warm-up times half a cosine."""
    return min(1.0, (step + 1) / _WARM) * (0.5 + 0.5 * math.cos(math.pi * step / steps))


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
    head: nn.Module, optimiser: torch.optim.Optimizer, batch: Batch, training: HeadTraining, step: int
) -> Tensor:
    """Run one optimiser step on a batch; returns its loss."""
    torch.manual_seed((training.seed << 24) + step)
    for group in optimiser.param_groups:
        group["lr"] = _RATE * rate_share(step, training.steps)
    head.train()
    loss = pixels_loss(head, batch) if isinstance(head, Pixels) else field_loss(head, batch)  # type: ignore[arg-type]
    optimiser.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    nn.utils.clip_grad_norm_(head.parameters(), 1.0)
    optimiser.step()
    return loss.detach()


def _initial_head(training: HeadTraining, folder: Path) -> nn.Module:
    """The head before its first step: random weights, or those of `training.start`."""
    if not training.start:
        return new_head(training.head, folder)
    start = Path(training.start)
    return load_pixels(start).train() if training.head == "pixels" else load_field(training.head, start)


def _state(head: nn.Module, optimiser: torch.optim.Optimizer, step: int, seconds: float) -> checkpoint.State:
    return {"head": head.state_dict(), "optimiser": optimiser.state_dict(), "step": step, "seconds": seconds}


def _restore(
    path: Path, mark: str, device: torch.device, head: nn.Module, optimiser: torch.optim.Optimizer
) -> tuple[int, float]:
    """Restore head and optimiser from the checkpoint, if there is one -> steps done, and the seconds that they took."""
    state = checkpoint.load(path, mark, device)
    if state is None:
        return 0, 0.0
    head.load_state_dict(state["head"])
    optimiser.load_state_dict(state["optimiser"])
    return int(state["step"]), float(state["seconds"])


def _autocast(device: torch.device) -> torch.autocast:
    """Use bfloat16 where it is fast: on a GPU, and on a CPU that can multiply it."""
    fast = device.type == "cuda" or bool(torch.ops.mkldnn._is_mkldnn_bf16_supported())
    return torch.autocast(device.type, torch.bfloat16, enabled=fast)
