"""How good a head is on shapes that it never saw."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from services.edge.guess.heads import Field, field_points
from services.edge.guess.lessons import Lesson, held_out
from services.edge.guess.losses import chamfer, f_score
from services.edge.guess.network import POINTS, Pixels
from services.edge.guess.shapes import about_vertical

_EACH = 6  # shapes of every class


def examined(head: nn.Module, device: torch.device) -> str:
    """Chamfer distance (mean squared, both ways added) and F within 0.05, things reaching 1 from their middle."""
    lesson = held_out(0, _EACH).to(device)
    head.eval()
    points = torch.cat([head_points(head, picture) for picture in torch.split(lesson.picture, 20)])
    truth = lesson.surface[:, :POINTS]
    figures = f"Chamfer {1e3 * chamfer(points, truth).mean():.2f}e-3, F {f_score(points, truth).mean():.3f}"
    return f"held out: {figures}{_own(head, lesson)}"


def _own(head: nn.Module, lesson: Lesson) -> str:
    """Of `pixels`: the same if it knew how the thing is turned."""
    if not isinstance(head, Pixels):
        return ""
    with torch.no_grad():
        own = head(lesson.picture).own
    known = chamfer(about_vertical(own, lesson.yaw), lesson.surface[:, :POINTS])
    return f"; yaw known: {1e3 * known.mean():.2f}e-3"


def head_points(head: nn.Module, picture: Tensor) -> Tensor:
    """What any head makes of pictures (n,4,64,64): (n,1024,3)."""
    if isinstance(head, Pixels):
        with torch.no_grad():
            points: Tensor = head(picture).points
        return points
    field: Field = head  # type: ignore[assignment]
    return field_points(field, field.see(picture), torch.Generator().manual_seed(0))
