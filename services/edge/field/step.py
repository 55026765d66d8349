"""What every fit shares: the step that a caller sees, the check of the points, and the end of a fit that diverges."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import DistanceFn, Floats
from capture2vr.edge.errors import EdgeError

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
            f"{len(xyz)} points are too few to fit a field; at least {least} are needed",
            hints=("scan the thing again, closer", "keep the preview, which needs no fit"),
        )
    return xyz


def refuse_divergence(losses: Mapping[str, float], exploded: float, learning_rate: float, step: int) -> None:
    """Raise EdgeError FIT_DIVERGED where the total loss is NaN or above `exploded`."""
    if losses["total"] < exploded:  # false for NaN too
        return
    raise EdgeError(
        "FIT_DIVERGED",
        f"the fit diverged at step {step:,}: its loss is {losses['total']:.3g}",
        hints=(
            "keep the preview, which needs no fit",
            f"choose a preset with a learning rate below {learning_rate:g}",
            "look for points far away from the others",
        ),
    )
