"""Evaluate a head on held-out shapes."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from tests.bench.single_photo_network.camera import about_vertical
from tests.bench.single_photo_network.network import POINTS, Pixels
from tests.bench.single_photo_training.batches import Batch, held_out_batch
from tests.bench.single_photo_training.field_heads import Field, field_points
from tests.bench.single_photo_training.losses import chamfer, f_score

_EACH = 6  # shapes of every class


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Figures of a head on held-out shapes of radius 1: mean Chamfer distance (squared, both ways added), F at 0.05."""

    chamfer: float
    f_score: float
    yaw_known: float | None = None

    def __str__(self) -> str:
        known = "" if self.yaw_known is None else f"; yaw known: {1e3 * self.yaw_known:.2f}e-3"
        return f"held out: Chamfer {1e3 * self.chamfer:.2f}e-3, F {self.f_score:.3f}{known}"


def evaluate_head(head: nn.Module, device: torch.device) -> Evaluation:
    """Evaluate a head on pictures of every class."""
    batch = held_out_batch(0, _EACH).to(device)
    head.eval()
    points = torch.cat([head_points(head, picture) for picture in torch.split(batch.picture, 20)])
    truth = batch.surface[:, :POINTS]
    distance, score = chamfer(points, truth).mean().item(), f_score(points, truth).mean().item()
    return Evaluation(distance, score, _with_true_yaw(head, batch))


def _with_true_yaw(head: nn.Module, batch: Batch) -> float | None:
    """Chamfer distance of `pixels` when its points are rotated by the true yaw; None for other heads."""
    if not isinstance(head, Pixels):
        return None
    with torch.no_grad():
        own = head(batch.picture).own
    return chamfer(about_vertical(own, batch.yaw), batch.surface[:, :POINTS]).mean().item()


def head_points(head: nn.Module, picture: Tensor) -> Tensor:
    """Predict points (n,1024,3) from pictures (n,4,64,64) with any head."""
    if isinstance(head, Pixels):
        with torch.no_grad():
            points: Tensor = head(picture).points
        return points
    field: Field = head  # type: ignore[assignment]
    return field_points(field, field.encode(picture), torch.Generator().manual_seed(0))
