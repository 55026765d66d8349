"""Run functions in a small thread pool. Threads suffice: numpy, the KD-tree and Embree release the interpreter lock."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from threading import Lock
from typing import TypeVar

from capture2vr.edge.arrays import Tick, no_tick

WORKERS = min(4, os.cpu_count() or 1)  # threads; more would slow a worker's other jobs and gain little: memory-bound

In = TypeVar("In")
Out = TypeVar("Out")


def in_threads(work: Callable[[In], Out], parts: Sequence[In], tick: Tick = no_tick) -> list[Out]:
    """Apply `work` to all parts on a few threads; return the results in the order of the parts.

    tick  called after each result, on the caller's thread; if it raises, the parts that have not begun are cancelled
    """
    pool = ThreadPoolExecutor(WORKERS)
    results = []
    with _opencv_on_one_thread():
        try:
            for result in pool.map(work, parts):
                results.append(result)
                tick(len(results) / len(parts))
        finally:
            # After an exception (a cancelled job's tick raises) the parts that still wait must not run.
            pool.shutdown(cancel_futures=True)
    return results


@contextmanager
def _opencv_on_one_thread() -> Iterator[None]:
    """Make OpenCV's functions run on the thread that calls them.

    Its own threads beside ours only wait for cores: depth of photos takes a tenth more time with them.
    """
    import cv2

    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


def one_ahead(work: Callable[[In], Out], parts: Iterable[In]) -> Iterator[Out]:
    """Yield `work` of all parts in their order; a thread works on the next part while the caller uses this one."""
    pool = ThreadPoolExecutor(1)
    waiting: deque[Future[Out]] = deque()
    try:
        for part in parts:
            waiting.append(pool.submit(work, part))
            if len(waiting) > 1:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)


def shared_ticks(tick: Tick, count: int) -> list[Tick]:
    """Make the ticks of `count` parts of the work that run at the same time: `tick` gets the mean of their fractions.

    It is called by one thread at a time, and once it has raised, all of them raise the same.
    """
    fractions, raised, lock = [0.0] * count, list[BaseException](), Lock()

    def report(number: int, fraction: float) -> None:
        with lock:
            if raised:
                raise raised[0]
            fractions[number] = fraction
            try:
                tick(sum(fractions) / count)
            except BaseException as error:
                raised.append(error)
                raise

    return [partial(report, number) for number in range(count)]


def slices(count: int, size: int) -> list[slice]:
    """Split range(count) into consecutive slices of `size`."""
    return [slice(start, min(start + size, count)) for start in range(0, count, size)]
