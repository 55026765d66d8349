"""Points in, a trained unsigned distance field out: of anchors (anchor_fit.py), or of a network:

1. draw the pool of queries                                                             (queries.py)
2. warm start: the network learns the local field, no gradients needed                  (a sixth of a step's cost)
3. the losses of the paper                                                              (losses.py)
4. where wanted, densify the points by the fitted surface, and go on                    (densify.py)

The arithmetic is float32 throughout: half precision resolves a unit frame to 5e-4, a tenth of a point spacing, and the
matrices are too small for it to be much faster.
"""

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path

import numpy as np

from services.edge.arrays import DistanceFn, Floats
from services.edge.field.anchor_fit import fit_anchors
from services.edge.field.compute import memory_errors_named, open_device
from services.edge.field.config import FitConfig
from services.edge.field.densify import densified
from services.edge.field.noise import Noise
from services.edge.field.objectives import paper_objective, paper_weights, regression_objective
from services.edge.field.queries import RANK, Batches, base_values, draw_pool
from services.edge.field.run import Run, Step, checked_points

__all__ = ["Step", "fit"]


def fit(
    xyz_unit: Floats,
    config: FitConfig,
    *,
    device: str = "cpu",
    base: DistanceFn | None = None,
    noise: Noise | None = None,
    held_out: Floats | None = None,
    checkpoint: Path | None = None,
) -> Generator[Step, None, None]:
    """Fit a field to points (N,3) in the unit frame; whoever stops iterating ends it.

    base        the local field of the denoised points, which the warm start of a network learns and anchors start from
    noise       of the points, which anchors weigh them by; None: it is measured
    held_out    (H,3) points that the fit must not see, by which `config.patience` decides; the best weights win
    checkpoint  the file that keeps the fit's state: written every few seconds, and read if the fit was killed

    The same points, config and device give the same field. While the pool is drawn, a step repeats its number, without
    losses. The last step's number is below `of` where patience ended the fit.
    Raises EdgeError FIT_TOO_FEW_POINTS, FIT_DIVERGED, GPU_OOM, DEVICE_ABSENT, and ValueError for points that are
    not finite or for a config that needs a `base` or `held_out` which is not there.
    """
    if config.model == "anchors":
        yield from fit_anchors(xyz_unit, config, device=device, base=base, noise=noise, checkpoint=checkpoint)
        return
    xyz = np.asarray(checked_points(xyz_unit, RANK + 1), np.float32)
    if config.warm_start and base is None:
        raise ValueError(f"{config.warm_start} steps of warm start need a base to learn")
    if config.patience and held_out is None:
        raise ValueError(f"a patience of {config.patience} steps needs held-out points")
    with memory_errors_named(f"the fit of {len(xyz):,} points in batches of {config.batch:,}"):
        run = Run(xyz, config, open_device(device), held_out, checkpoint)
        pool = yield from run.waiting(draw_pool(xyz, config, run.device))
        if run.done < config.warm_start and base is not None:
            target = yield from run.waiting(base_values(pool, base))
            batches = Batches(len(target), config.batch, config.seed, run.device)
            regression = regression_objective(run.network, pool, target)
            yield from run.descend(regression, {"regression": 1.0}, batches, config.warm_start)
        end = config.warm_start + config.steps
        if run.done < end:
            batches = Batches(len(pool), config.batch, config.seed, run.device)
            paper = paper_objective(run.network, pool, run.memory_of(pool), config, batches.size)
            yield from run.descend(paper, paper_weights(config), batches, end)
        if config.densify and not run.ended:
            if run.added is None:
                run.densify_by((yield from run.waiting(densified(run.network, pool, config.densify, config.seed))))
            pool = yield from run.waiting(draw_pool(np.concatenate([xyz, run.added]), config, run.device))
            batches = Batches(len(pool), config.densify.batch, config.seed, run.device)
            paper = paper_objective(run.network, pool, run.memory_of(pool), config, batches.size)
            yield from run.descend(paper, paper_weights(config), batches, config.total_steps)
        if run.take_best():
            yield run.step({})
