"""Train a network whose output is the unsigned distance field of points, as the paper does.

1. draw the pool of queries                                                             (queries.py)
2. warm start: the network learns the local field, no gradients needed                  (a sixth of a step's cost)
3. the losses of the paper                                                              (losses.py)
4. if configured, densify the points by the fitted surface, and train on                (densify.py)

The arithmetic is float32 throughout: half precision resolves a unit frame to 5e-4, a tenth of a point spacing, and the
matrices are too small for it to be much faster.
"""

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path

import numpy as np

from capture2vr.edge.arrays import DistanceFn, Floats
from capture2vr.edge.field.compute import open_device, translate_memory_errors
from capture2vr.edge.field.step import Step, check_points
from capture2vr.edge.paper_field.densify import densify_points
from capture2vr.edge.paper_field.network_config import Densify, NetworkConfig
from capture2vr.edge.paper_field.network_run import NetworkRun
from capture2vr.edge.paper_field.objectives import paper_objective, paper_weights, regression_objective
from capture2vr.edge.paper_field.queries import RANK, Batches, Pool, base_values, draw_pool


def fit_network(
    xyz_unit: Floats,
    config: NetworkConfig,
    *,
    device: str = "cpu",
    base: DistanceFn | None = None,
    held_out: Floats | None = None,
    checkpoint: Path | None = None,
    metres: float | None = None,
) -> Generator[Step, None, None]:
    """Train a network on points (N,3) in the unit frame. Stop iterating to end the fit.

    base        the local field of the denoised points, which the warm start learns
    held_out    (H,3) points that the fit must not see, for early stopping by `config.patience`: the best weights win
    checkpoint  file of the fit's state: written every few seconds, and read when a killed fit is started again
    metres      length of the unit frame's longest side, where it is known: the anchors' densities are per square metre

    The same points, config and device give the same field. While the pool is drawn, steps repeat a number and have no
    losses. The last step's number is below `of` where patience ended the fit. A fit that was killed after its last step
    yields that step again.
    Raises EdgeError FIT_TOO_FEW_POINTS, FIT_DIVERGED, GPU_OOM, DEVICE_ABSENT, and ValueError for points that are
    not finite or for a config that needs a `base` or `held_out` which is missing.
    """
    xyz = np.asarray(check_points(xyz_unit, RANK + 1), np.float32)
    _check_inputs(config, base, held_out)
    with translate_memory_errors(f"the fit of {len(xyz):,} points in batches of {config.batch:,}"):
        run = NetworkRun(xyz, config, open_device(device), held_out, checkpoint, metres)
        if run.ended or run.done == config.total_steps:  # killed after its last step: no pool is needed any more
            run.restore_best()
            yield run.step(run.losses)
            return
        pool = yield from run.yield_steps(draw_pool(xyz, config, run.device, metres))
        if run.done < config.warm_start and base is not None:
            target = yield from run.yield_steps(base_values(pool, base))
            batches = Batches(len(target), config.batch, config.seed, run.device)
            regression = regression_objective(run.network, pool, target)
            yield from run.descend(regression, {"regression": 1.0}, batches, config.warm_start)
        end = config.warm_start + config.steps
        if run.done < end:
            batches = Batches(len(pool), config.batch, config.seed, run.device)
            paper = paper_objective(run.network, pool, run.memory_of(pool), config, batches.size)
            yield from run.descend(paper, paper_weights(config), batches, end)
        if config.densify and not run.ended:
            pool = yield from _densified(run, xyz, pool, config, config.densify, metres)
            batches = Batches(len(pool), config.densify.batch, config.seed, run.device)
            paper = paper_objective(run.network, pool, run.memory_of(pool), config, batches.size)
            yield from run.descend(paper, paper_weights(config), batches, config.total_steps)
        if run.restore_best():
            yield run.step({})


def _check_inputs(config: NetworkConfig, base: DistanceFn | None, held_out: Floats | None) -> None:
    """Raises ValueError for a config that needs a base field or held-out points which are missing."""
    if config.warm_start and base is None:
        raise ValueError(f"a warm start of {config.warm_start} steps needs a base field to learn")
    if config.patience and held_out is None:
        raise ValueError(f"a patience of {config.patience} steps needs held-out points")


def _densified(
    run: NetworkRun, xyz: Floats, pool: Pool, config: NetworkConfig, densify: Densify, metres: float | None
) -> Generator[Step, None, Pool]:
    """Add points of the fitted surface to the points (N,3), unless the run has them, and draw the pool of both."""
    if run.added is None:
        run.add_points((yield from run.yield_steps(densify_points(run.network, pool, densify, config.seed))))
    both = np.concatenate([xyz, run.added])
    return (yield from run.yield_steps(draw_pool(both, config, run.device, metres)))
