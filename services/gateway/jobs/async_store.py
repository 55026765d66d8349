"""Async access to the job store: runs its calls on threads, and notifies listeners of every change.

One thread writes: SQLite allows one writer anyway, and a queue in front of it is fairer and faster than its lock. A few
threads read. Uploads use other threads, so that a request about a job never waits for 32 phones.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Concatenate, ParamSpec, TypeVar

from services.gateway.jobs.job import Job
from services.gateway.jobs.notifier import JobNotifier
from services.gateway.jobs.state_machine import Change
from services.gateway.jobs.store import JobStore

P = ParamSpec("P")
T = TypeVar("T")

_READERS = 4


class AsyncJobStore:
    """Calls `JobStore` methods on threads: `await job_store.read(JobStore.get, id)`."""

    def __init__(self, store: JobStore) -> None:
        self._store = store
        self._readers = ThreadPoolExecutor(_READERS, "jobs-read")
        self._writer = ThreadPoolExecutor(1, "jobs-write")
        self.notifier = JobNotifier()

    @property
    def blocking(self) -> JobStore:
        """The store itself, for work that is on a thread already."""
        return self._store

    async def read(self, what: Callable[Concatenate[JobStore, P], T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Call a reading method of the store."""
        return await _run_on(self._readers, lambda: what(self._store, *args, **kwargs))

    async def write(self, what: Callable[Concatenate[JobStore, P], T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Call a writing method of the store; if it returns a Job, notify the job's listeners."""
        result = await _run_on(self._writer, lambda: what(self._store, *args, **kwargs))
        if isinstance(result, Job):
            self.notifier.notify(result.id)
        return result

    async def change(self, job: str, transition: Callable[[Job], Change]) -> Job:
        """Apply a state transition to a job, and notify its listeners."""
        return await self.write(JobStore.change, job, transition)

    def close(self) -> None:
        """Wait for calls in progress, then end the threads."""
        self._writer.shutdown()
        self._readers.shutdown()


async def _run_on(threads: ThreadPoolExecutor, call: Callable[[], T]) -> T:
    return await asyncio.get_running_loop().run_in_executor(threads, call)
