"""Work on a few threads: numpy, the KD-tree and Embree let go of the interpreter."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from services.edge.arrays import Tick, no_tick

WORKERS = min(4, os.cpu_count() or 1)  # more would crowd a worker's other jobs and gain little: memory binds

In = TypeVar("In")
Out = TypeVar("Out")


def in_threads(work: Callable[[In], Out], parts: Sequence[In], tick: Tick = no_tick) -> list[Out]:
    """The work's results in the order of the parts. `tick` hears after each, on this thread; if it raises, all ends."""
    pool = ThreadPoolExecutor(WORKERS)
    results = []
    try:
        for result in pool.map(work, parts):
            results.append(result)
            tick(len(results) / len(parts))
    finally:
        # After an exception (a cancelled job's tick raises) the parts that wait must not run.
        pool.shutdown(cancel_futures=True)
    return results


def slices(count: int, size: int) -> list[slice]:
    """Consecutive slices of `size` that cover range(count)."""
    return [slice(start, min(start + size, count)) for start in range(0, count, size)]
