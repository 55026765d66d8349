"""Evaluate a head on held-out shapes."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from services.edge.single_photo.camera import about_vertical
from services.edge.single_photo.network import POINTS, Pixels
from services.edge.single_photo_training.batches import Batch, held_out_batch
from services.edge.single_photo_training.field_heads import Field, field_points
from services.edge.single_photo_training.losses import chamfer, f_score

_EACH = 6  # shapes of every class


def evaluate_head(head: nn.Module, device: torch.device) -> str:
    """One line: Chamfer distance (mean squared, both ways added) and F-score at 0.05 of things of radius 1."""
    batch = held_out_batch(0, _EACH).to(device)
    head.eval()
    points = torch.cat([head_points(head, picture) for picture in torch.split(batch.picture, 20)])
    truth = batch.surface[:, :POINTS]
    figures = f"Chamfer {1e3 * chamfer(points, truth).mean():.2f}e-3, F {f_score(points, truth).mean():.3f}"
    return f"held out: {figures}{_with_true_yaw(head, batch)}"


def _with_true_yaw(head: nn.Module, batch: Batch) -> str:
    """Chamfer distance of `pixels` when its points are rotated by the true yaw; "" for other heads."""
    if not isinstance(head, Pixels):
        return ""
    with torch.no_grad():
        own = head(batch.picture).own
    known = chamfer(about_vertical(own, batch.yaw), batch.surface[:, :POINTS])
    return f"; yaw known: {1e3 * known.mean():.2f}e-3"


def head_points(head: nn.Module, picture: Tensor) -> Tensor:
    """Predict points (n,1024,3) from pictures (n,4,64,64) with any head."""
    if isinstance(head, Pixels):
        with torch.no_grad():
            points: Tensor = head(picture).points
        return points
    field: Field = head  # type: ignore[assignment]
    return field_points(field, field.encode(picture), torch.Generator().manual_seed(0))
