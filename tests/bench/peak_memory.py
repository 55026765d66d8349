"""Peak memory of a process and its children together, sampled on a thread."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from threading import Event, Thread

import psutil

_EVERY_S = 0.2


class PeakMemory:
    """The most resident memory so far, MB: libraries that processes share count for each."""

    def __init__(self) -> None:
        self.megabytes = 0.0

    def sample(self) -> None:
        """Look once."""
        here, total = psutil.Process(), 0
        for process in (here, *here.children(recursive=True)):
            with suppress(psutil.NoSuchProcess):  # it has ended meanwhile
                total += process.memory_info().rss
        self.megabytes = max(self.megabytes, total / 1e6)


@contextmanager
def peak_memory() -> Iterator[PeakMemory]:
    """Sample until the end of the block."""
    peak, stop = PeakMemory(), Event()

    def watch() -> None:
        while not stop.wait(_EVERY_S):
            peak.sample()

    thread = Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield peak
    finally:
        stop.set()
        thread.join()
        peak.sample()
