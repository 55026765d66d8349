"""What every fit shares: the step that a caller sees, the check of the points, and the end of a fit that diverges."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import DistanceFn, Floats
from capture2vr.edge.errors import EdgeError
from capture2vr.sentences.sentence import say

PER_YIELD = {"cpu": 1, "cuda": 25}  # steps between two yields: reading the losses makes a GPU wait
STEPS_BEFORE_CAPTURE = 3  # as a CUDA graph: allocators, cuBLAS and Adam's state settle in them


@dataclass(frozen=True, slots=True)
class Step:
    """Progress of a fit: step `number` of `of`, the losses by name, and the field with the weights of this step."""

    number: int
    of: int
    losses: Mapping[str, float]
    field: DistanceFn


def check_points(xyz_unit: Floats, least: int) -> Floats:
    """Return the points (N,3) as float64. Raises ValueError for another shape or NaN, EdgeError for too few."""
    xyz = np.ascontiguousarray(xyz_unit, np.float64)
    if xyz.ndim != 2 or xyz.shape[1] != 3:
        raise ValueError(f"a fit needs (N,3) points, not {xyz.shape}")
    if not np.isfinite(xyz).all():
        raise ValueError(f"{int((~np.isfinite(xyz)).any(axis=1).sum())} points are not finite")
    if len(xyz) < least:
        raise EdgeError(
            "FIT_TOO_FEW_POINTS",
            say("points_too_few_to_fit", count=len(xyz), least=least),
            hints=(say("scan_thing_again_closer"), say("keep_preview_needs_no_fit")),
        )
    return xyz


def refuse_divergence(losses: Mapping[str, float], exploded: float, learning_rate: float, step: int) -> None:
    """Raise EdgeError FIT_DIVERGED where the total loss is NaN or above `exploded`."""
    if losses["total"] < exploded:  # false for NaN too
        return
    raise EdgeError(
        "FIT_DIVERGED",
        say("fit_diverged_step_loss", step=step, loss=losses["total"]),
        hints=(
            say("keep_preview_needs_no_fit"),
            say("choose_preset_with_learning_rate", rate=learning_rate),
            say("look_points_far_away"),
        ),
    )
