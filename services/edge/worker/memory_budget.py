"""The memory that a worker's fits share: a job waits for its part rather than running machine or GPU out of it."""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

_LOOK_S = 0.2
"""Seconds between two words of a job that waits: it must hear of its cancellation within two seconds."""

_SHARE = 0.6
"""Of the machine's memory, for fits: the rest is for captures, previews and meshes of the jobs, and for the system."""

_CGROUP = Path("/sys/fs/cgroup/memory.max")


class Memory:
    """Bytes to be had, first come first served. Used from the threads of the jobs."""

    def __init__(self, total_bytes: int) -> None:
        self.total_bytes = total_bytes
        self._free = total_bytes
        self._queue: deque[object] = deque()
        self._changed = threading.Condition()

    @contextmanager
    def held(self, wanted_bytes: int, waits: Callable[[], None]) -> Iterator[None]:
        """Hold that much, at most all there is; until it is free, `waits` is called and may raise to give up."""
        wanted_bytes = min(wanted_bytes, self.total_bytes)
        self._take(wanted_bytes, waits)
        try:
            yield
        finally:
            with self._changed:
                self._free += wanted_bytes
                self._changed.notify_all()

    def _take(self, wanted_bytes: int, waits: Callable[[], None]) -> None:
        ticket = object()
        with self._changed:
            self._queue.append(ticket)
        try:
            while not self._granted(ticket, wanted_bytes):
                waits()
        finally:
            with self._changed:
                self._queue.remove(ticket)
                self._changed.notify_all()

    def _granted(self, ticket: object, wanted_bytes: int) -> bool:
        """Whether it is this one's turn and there is enough; a small job does not overtake a large one for ever."""

        def free() -> bool:
            return self._queue[0] is ticket and self._free >= wanted_bytes

        with self._changed:
            if not self._changed.wait_for(free, _LOOK_S):
                return False
            self._free -= wanted_bytes
            return True


def machine_bytes() -> int:
    """What fits may take of this machine's memory, or of the container's where that is less."""
    physical = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return int(_SHARE * min(physical, _container_bytes() or physical))


def _container_bytes() -> int:
    """The container's limit (cgroup version 2); 0 where there is none."""
    try:
        limit = _CGROUP.read_text().strip()
    except OSError:
        return 0
    return int(limit) if limit.isdecimal() else 0
