"""Memory budget that a worker's fits share: a job waits until its part is free, so that neither machine nor GPU runs
out of memory."""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from capture2vr.edge.worker.control_group import own_control_group

_POLL_S = 0.2
"""Seconds between two reports of a job that waits: a cancellation must take effect within two seconds."""

_SHARE = 0.6
"""Share of the machine's memory for fits: the rest is for the jobs' captures, previews and meshes, and the system."""


class MemoryBudget:
    """Bytes that jobs reserve, first in, first out. Used from the threads of the jobs."""

    def __init__(self, total_bytes: int) -> None:
        self.total_bytes = total_bytes
        self._free = total_bytes
        self._queue: deque[object] = deque()
        self._changed = threading.Condition()

    @contextmanager
    def reserve(self, wanted_bytes: int, on_wait: Callable[[], None]) -> Iterator[None]:
        """Wait for that many bytes, at most the whole budget, and reserve them for the block.

        on_wait  called several times a second while waiting; it may raise to give up
        """
        wanted_bytes = min(wanted_bytes, self.total_bytes)
        self._take(wanted_bytes, on_wait)
        try:
            yield
        finally:
            with self._changed:
                self._free += wanted_bytes
                self._changed.notify_all()

    def _take(self, wanted_bytes: int, on_wait: Callable[[], None]) -> None:
        ticket = object()
        with self._changed:
            self._queue.append(ticket)
        try:
            while not self._try_take(ticket, wanted_bytes):
                on_wait()
        finally:
            with self._changed:
                self._queue.remove(ticket)
                self._changed.notify_all()

    def _try_take(self, ticket: object, wanted_bytes: int) -> bool:
        """Reserve the bytes if this ticket is the first in the queue and enough are free, within _POLL_S; else False.

        Strictly in order, so that small jobs cannot overtake a large one for ever.
        """

        def is_free() -> bool:
            return self._queue[0] is ticket and self._free >= wanted_bytes

        with self._changed:
            if not self._changed.wait_for(is_free, _POLL_S):
                return False
            self._free -= wanted_bytes
            return True


def machine_bytes() -> int:
    """Bytes that fits may take: a share of this machine's memory, or of the container's limit where that is less."""
    return int(_SHARE * whole_machine_bytes())


def whole_machine_bytes() -> int:
    """Bytes of this machine's memory, or of the container's limit where that is less."""
    physical = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return min(physical, own_control_group().limit_bytes or physical)


def machine_cores() -> int:
    """Cores that this process may use: those of the machine, or of the container's limit where that is less."""
    cores = len(os.sched_getaffinity(0))
    return max(1, min(cores, int(own_control_group(controller="cpu").core_limit or cores)))
