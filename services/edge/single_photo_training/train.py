"""The training of a head: one loop, a checkpoint now and then, half-precision weights at the end.

What a step learns from depends on the seed and the step's number alone, so a killed training goes on from its
checkpoint to the same weights as one that nobody stopped, on the CPU.
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
from services.edge.guess.examine import examined
from services.edge.guess.heads import Field, with_gradient
from services.edge.guess.lessons import Lesson, lessons
from services.edge.guess.losses import chamfer_loss, nearest, udf_loss
from services.edge.guess.network import POINTS, Pixels, bin_of
from services.edge.guess.pictures import project
from services.edge.guess.shapes import about_vertical
from services.edge.guess.weights import Trained, load_field, load_pixels, new_head, save_half

_RATE = 5e-4  # of AdamW at its height; at 1e-3 the figures stood still
_WARM = 300  # steps until then
_BETAS = (0.9, 0.99)  # a short memory of the squares, for a short training
_DECAY = 0.01
_SAVED_S = 30.0  # between checkpoints
_TOLD = 100  # steps between lines of progress
_EXAMINED = 2000  # steps between looks at held-out shapes
_CAMERA = 0.05  # weight of the camera's error, in half pictures, beside (2) of `losses.py`
_YAW = 0.03  # weight of the cross-entropy of the yaw, which begins at 3.6
_FIRST = 0.5  # weight of the points before they are moved
_TOLD_YAW = 0.5  # share of a batch that is turned as the truth says
_QUERIES = 256  # per picture
_BANDS = (0.02, 0.06, 0.15)  # 1 sigma, of the queries' distances from the surface; a seventh of them are anywhere


@dataclass(frozen=True, slots=True)
class Training:
    """Everything that the result depends on, but the backbone of a field.

    start: folder of trained weights to begin from, or "" for random ones.
    """

    head: str
    steps: int
    seed: int = 0
    start: str = ""


def train(training: Training, folder: Path, device: torch.device, *, say: Callable[[str], None] = print) -> nn.Module:
    """Train, or go on; returns the trained head, which then is in `folder` as HEAD.pt too."""
    torch.manual_seed(training.seed)
    head: nn.Module = _beginning(training, folder).to(device=device, memory_format=torch.channels_last)  # type: ignore[call-overload]
    learning = [each for each in head.parameters() if each.requires_grad]
    optimiser = torch.optim.AdamW(learning, lr=_RATE, betas=_BETAS, weight_decay=_DECAY)
    path, mark = folder / f"{training.head}.checkpoint", f"{training!r} {device.type}"
    step, spent = _resumed(path, mark, device, head, optimiser)
    seconds = spent
    began = saved = time.monotonic()
    for lesson in lessons(training.seed, step):
        if step >= training.steps:
            break
        loss = _learn(head, optimiser, lesson.to(device), training, step)
        step += 1
        seconds = spent + time.monotonic() - began
        if step % _TOLD == 0 or step == training.steps:
            left = (training.steps - step) * seconds / step
            say(f"step {step}/{training.steps}  loss {loss.item():.4f}  {seconds:.0f} s, {left:.0f} s left")
        if step % _EXAMINED == 0:
            say(f"step {step}: {examined(head, device)}")
        if time.monotonic() - saved > _SAVED_S or step == training.steps:
            saved = time.monotonic()
            checkpoint.save(path, _state(head, optimiser, step, seconds), mark)
    save_half(head, Trained(step, round(seconds, 1)), folder / f"{training.head}.pt")
    return head


def pace(step: int, steps: int) -> float:
    """Share of the learning rate: up in a line, down in half a cosine."""
    return min(1.0, (step + 1) / _WARM) * (0.5 + 0.5 * math.cos(math.pi * step / steps))


def pixels_loss(head: Pixels, lesson: Lesson) -> Tensor:
    """Of a batch: where the points are, before and after they are moved, how the thing is turned, where the camera is.

    Half of the things are turned as they are and half as the network says, for it to learn what is then wrong.
    """
    told = torch.where(torch.rand(len(lesson.yaw)).to(lesson.yaw.device) < _TOLD_YAW, lesson.yaw, torch.nan)
    with _halved(lesson.picture.device):
        seen = head(lesson.picture, told)
    surface = lesson.surface[:, torch.randperm(lesson.surface.shape[1])[:POINTS]]
    some = lesson.surface[:, :64]
    off = (project(some, seen.camera)[0] - project(some, lesson.camera)[0]).abs().mean()
    turned = functional.cross_entropy(seen.bins, bin_of(lesson.yaw))
    first = chamfer_loss(seen.own, about_vertical(surface, -lesson.yaw))
    return chamfer_loss(seen.points, surface) + _FIRST * first + _CAMERA * off + _YAW * turned


def field_loss(head: Field, lesson: Lesson) -> Tensor:
    """Of a batch: the distances, and the directions in which they grow, at queries around the surface."""
    with _halved(lesson.picture.device):
        seen = head.see(lesson.picture)
    q = _queries(lesson.surface)
    to_surface, _ = nearest(q, lesson.surface)
    away = q - lesson.surface.gather(1, to_surface[..., None].expand(-1, -1, 3))
    true_distance = away.norm(dim=2)
    distance, gradient = with_gradient(head, seen, q, learn=True)
    return udf_loss(distance, gradient, true_distance, away / true_distance.clamp(min=1e-6)[..., None])


def _queries(surface: Tensor) -> Tensor:
    """(n,_QUERIES,3): most of them around points of the surface."""
    n = len(surface)
    q = surface[:, torch.randperm(surface.shape[1])[:_QUERIES]].clone()
    band = torch.tensor(_BANDS)[torch.randint(len(_BANDS), (n, _QUERIES, 1))]
    q += (band * torch.randn(n, _QUERIES, 3)).to(q.device)
    q[:, ::7] = 2 * torch.rand(n, q[:, ::7].shape[1], 3).to(q.device) - 1
    return q


def _learn(head: nn.Module, optimiser: torch.optim.Optimizer, lesson: Lesson, training: Training, step: int) -> Tensor:
    torch.manual_seed((training.seed << 24) + step)
    for group in optimiser.param_groups:
        group["lr"] = _RATE * pace(step, training.steps)
    head.train()
    loss = pixels_loss(head, lesson) if isinstance(head, Pixels) else field_loss(head, lesson)  # type: ignore[arg-type]
    optimiser.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    nn.utils.clip_grad_norm_(head.parameters(), 1.0)
    optimiser.step()
    return loss.detach()


def _beginning(training: Training, folder: Path) -> nn.Module:
    if not training.start:
        return new_head(training.head, folder)
    start = Path(training.start)
    return load_pixels(start).train() if training.head == "pixels" else load_field(training.head, start)


def _state(head: nn.Module, optimiser: torch.optim.Optimizer, step: int, seconds: float) -> checkpoint.State:
    return {"head": head.state_dict(), "optimiser": optimiser.state_dict(), "step": step, "seconds": seconds}


def _resumed(
    path: Path, mark: str, device: torch.device, head: nn.Module, optimiser: torch.optim.Optimizer
) -> tuple[int, float]:
    """Steps done and the seconds that they took."""
    state = checkpoint.load(path, mark, device)
    if state is None:
        return 0, 0.0
    head.load_state_dict(state["head"])
    optimiser.load_state_dict(state["optimiser"])
    return int(state["step"]), float(state["seconds"])


def _halved(device: torch.device) -> torch.autocast:
    """bfloat16 where it is fast: on any GPU that one trains on, and where the CPU multiplies it."""
    fast = device.type == "cuda" or bool(torch.ops.mkldnn._is_mkldnn_bf16_supported())
    return torch.autocast(device.type, torch.bfloat16, enabled=fast)
