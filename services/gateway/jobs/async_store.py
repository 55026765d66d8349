"""The jobs as the event loop sees them: every call on a thread, every change announced to those who listen.

One thread writes: SQLite has one writer anyway, and a queue in front of it is fairer and faster than its lock. A few
read, and none of them is shared with uploads, so that a question about a job never waits behind 32 phones.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Concatenate, ParamSpec, TypeVar

from sqlalchemy.exc import SQLAlchemyError

from services.gateway.jobs.hub import Hub
from services.gateway.jobs.job import Job
from services.gateway.jobs.store import JobStore
from services.gateway.jobs.transitions import Change

P = ParamSpec("P")
T = TypeVar("T")

_READERS = 4
_POLL_S = 1.0  # how late this process learns what another gateway on the same database wrote

_log = logging.getLogger(__name__)


class Desk:
    """`await desk.read(JobStore.get, id)`, `await desk.write(JobStore.create, order)`, `await desk.change(id, …)`."""

    def __init__(self, store: JobStore) -> None:
        self._store = store
        self._readers = ThreadPoolExecutor(_READERS, "jobs-read")
        self._writer = ThreadPoolExecutor(1, "jobs-write")
        self.hub = Hub()

    async def read(self, what: Callable[Concatenate[JobStore, P], T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Ask the store something."""
        return await _on(self._readers, lambda: what(self._store, *args, **kwargs))

    async def write(self, what: Callable[Concatenate[JobStore, P], T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Have the store write something; a Job that comes back is announced."""
        result = await _on(self._writer, lambda: what(self._store, *args, **kwargs))
        if isinstance(result, Job):
            self.hub.notify(result.id)
        return result

    async def change(self, job: str, transition: Callable[[Job], Change]) -> Job:
        """Apply a transition and announce it."""
        return await self.write(JobStore.change, job, transition)

    async def follow_others(self) -> None:
        """Announce what other processes wrote; one cheap question a second, however many listeners there are."""
        last = await self.read(JobStore.newest_event)
        while True:
            await asyncio.sleep(_POLL_S)
            try:
                last, touched = await self.read(JobStore.touched, last)
            except SQLAlchemyError:
                _log.exception("the jobs database cannot be read")
                continue
            for job in touched:
                self.hub.notify(job)

    def close(self) -> None:
        """Wait for what is being written, then let the threads go."""
        self._writer.shutdown()
        self._readers.shutdown()


async def _on(threads: ThreadPoolExecutor, call: Callable[[], T]) -> T:
    return await asyncio.get_running_loop().run_in_executor(threads, call)
