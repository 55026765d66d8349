"""Run functions in a small thread pool. Threads suffice: numpy, the KD-tree and Embree release the interpreter lock."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from services.edge.arrays import Tick, no_tick

WORKERS = min(4, os.cpu_count() or 1)  # threads; more would slow a worker's other jobs and gain little: memory-bound

In = TypeVar("In")
Out = TypeVar("Out")


def in_threads(work: Callable[[In], Out], parts: Sequence[In], tick: Tick = no_tick) -> list[Out]:
    """Apply `work` to all parts on a few threads; return the results in the order of the parts.

    tick  called after each result, on the caller's thread; if it raises, the parts that have not begun are cancelled
    """
    pool = ThreadPoolExecutor(WORKERS)
    results = []
    try:
        for result in pool.map(work, parts):
            results.append(result)
            tick(len(results) / len(parts))
    finally:
        # After an exception (a cancelled job's tick raises) the parts that still wait must not run.
        pool.shutdown(cancel_futures=True)
    return results


def slices(count: int, size: int) -> list[slice]:
    """Split range(count) into consecutive slices of `size`."""
    return [slice(start, min(start + size, count)) for start in range(0, count, size)]
