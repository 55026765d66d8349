"""Watch the memory of the jobs' processes: where they take too much together, the largest one ends, and no other."""

from __future__ import annotations

import threading
import time

import psutil

from capture2vr.edge.worker.memory_budget import whole_machine_bytes

_SHARE = 0.9
"""Share of the machine's memory for all jobs together: the rest is for the worker, and the system."""
_EVERY_S = 0.5
"""Seconds between two looks: asking for the memory of a process and its children takes a millisecond."""


class MemoryWatch:
    """Tells the jobs, from their threads, which of them has to end. most_bytes: 0: a share of this machine's"""

    def __init__(self, most_bytes: int = 0) -> None:
        self._most_bytes = most_bytes or int(_SHARE * whole_machine_bytes())
        self._taken: dict[int, int] = {}
        self._looked: dict[int, float] = {}
        self._lock = threading.Lock()

    def is_too_large(self, process: int) -> bool:
        """Whether the processes of all jobs take too much memory, and this one with its children takes most of it."""
        now = time.monotonic()
        with self._lock:
            if not process or now - self._looked.get(process, -_EVERY_S) < _EVERY_S:
                return False
            self._looked[process] = now
            self._taken[process] = tree_bytes(process)
            return (
                sum(self._taken.values()) > self._most_bytes
                and max(self._taken, key=self._taken.__getitem__) == process
            )

    def forget(self, process: int) -> None:
        """Count a process no more, which has ended."""
        with self._lock:
            self._taken.pop(process, None)
            self._looked.pop(process, None)


def tree_bytes(process: int) -> int:
    """Resident memory of a process and of all that it has started; of those that have just ended, nothing."""
    try:
        parent = psutil.Process(process)
        tree = [parent, *parent.children(recursive=True)]
    except psutil.Error:
        return 0
    return sum(map(_resident, tree))


def _resident(process: psutil.Process) -> int:
    try:
        return int(process.memory_info().rss)
    except psutil.Error:
        return 0
