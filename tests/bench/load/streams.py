"""Trainings of several jobs in one process of a worker on a GPU: steps a second, on one CUDA stream and on one each.

All trainings warm up first, then are counted for the same seconds. Every second one is of LevelSetUDF, so that two
graphs of different length run beside each other.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import partial
from threading import Barrier

import numpy as np

from capture2vr.edge.field.device import find_device, own_stream
from capture2vr.edge.paper_field.network_config import NetworkConfig
from capture2vr.edge.paper_field.network_fit import fit_network
from capture2vr.edge.preset import load_preset
from tests.bench.paper.complexity import WARM
from tests.support import surfaces

_BATCH, _POOL = 1_000, 100_000


def main(arguments: list[str]) -> None:
    """Print the table."""
    options = _parser().parse_args(arguments)
    device = find_device(options.device)
    print(f"{device.description}, {_BATCH:,} queries a step\n")
    print("| trainings | one stream, steps a second in all | a stream each | ratio | slowest of them |")
    print("|---|---|---|---|---|")
    for count in options.jobs:
        shared = steps_a_second(count, device.name, options.seconds, nullcontext)
        own = steps_a_second(count, device.name, options.seconds, partial(own_stream, device.name))
        print(f"| {count} | {sum(shared):,.0f} | {sum(own):,.0f} | {sum(own) / sum(shared):.2f} | {min(own):,.0f} |")


def steps_a_second(
    count: int, device: str, seconds: float, stream: Callable[[], AbstractContextManager[None]]
) -> list[float]:
    """The steps a second of each of `count` trainings that run at the same time, each inside a `stream()`."""
    points = surfaces.sampled(surfaces.hemisphere(), 10_000)
    warm = Barrier(count)

    def train(number: int) -> float:
        config = load_preset("levelset-udf" if number % 2 else "paper").fit
        assert isinstance(config, NetworkConfig)
        config = replace(config, batch=_BATCH, pool=_POOL, seed=number)
        with stream():
            steps = (step for step in fit_network(np.array(points), config, device=device) if step.losses)
            first = next(step for step in steps if step.number > WARM)
            warm.wait()
            began = time.perf_counter()
            for step in steps:
                passed = time.perf_counter() - began
                if passed > seconds:
                    return (step.number - first.number) / passed
        raise ValueError(f"{seconds} s are longer than a whole training")

    with ThreadPoolExecutor(count) as pool:
        return list(pool.map(train, range(count)))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.bench streams", description=__doc__)
    parser.add_argument("--jobs", type=int, nargs="+", default=[1, 2, 4, 8], help="trainings at the same time")
    parser.add_argument("--seconds", type=float, default=5, help="of every count")
    parser.add_argument("--device", default="cuda", help="cuda:1 for the second GPU")
    return parser
