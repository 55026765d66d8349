"""A running product whose cost is measured: the processor seconds and the memory of its services and their children."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

import psutil

_SAMPLE_S = 0.01  # between two looks at the memory; the kernel keeps each process's peak in between


def processor_seconds(services: Iterable[psutil.Process]) -> float:
    """Processor seconds of the services and of all that they have started, ended or not."""
    seconds = 0.0
    for service in services:
        for process in (service, *service.children(recursive=True)):
            with suppress(psutil.NoSuchProcess):
                spent = process.cpu_times()
                seconds += spent.user + spent.system + spent.children_user + spent.children_system
    return seconds


class PeakMemory:
    """Watches the memory of all processes below some others in a block; `mb` is the most that one had."""

    def __init__(self, above: Iterable[psutil.Process]) -> None:
        self._above = list(above)
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._watch)
        self.mb = 0.0

    def __enter__(self) -> PeakMemory:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ends.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._ends.wait(_SAMPLE_S):
            for service in self._above:
                for process in service.children(recursive=True):
                    self.mb = max(self.mb, peak_mb(process.pid))


def peak_mb(process: int) -> float:
    """The most memory that a process had, in MB; 0 for one that has ended."""
    with suppress(OSError, StopIteration):
        lines = Path(f"/proc/{process}/status").read_text().splitlines()
        return int(next(line for line in lines if line.startswith("VmHWM")).split()[1]) / 1024
    return 0.0
