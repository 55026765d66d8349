"""Async access to the job store: runs its calls on threads, and notifies listeners of every change.

One thread writes: SQLite allows one writer anyway, and a queue in front of it is fairer and faster than its lock. A few
threads read. Uploads use other threads, so that a request about a job never waits for 32 phones.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Concatenate, ParamSpec, TypeVar

from sqlalchemy.exc import DBAPIError

from capture2vr.gateway.database_faults import Fault, fault_of
from capture2vr.gateway.jobs.job import Job
from capture2vr.gateway.jobs.notifier import JobNotifier
from capture2vr.gateway.jobs.state_machine import Change
from capture2vr.gateway.jobs.store import JobStore

P = ParamSpec("P")
T = TypeVar("T")

_READERS = 4
_FULL_S = 60.0  # for which a database counts as full; then the next change tells, as nothing else of it does


class AsyncJobStore:
    """Calls `JobStore` methods on threads: `await job_store.read(JobStore.get, id)`."""

    def __init__(self, store: JobStore) -> None:
        self._store = store
        self._readers = ThreadPoolExecutor(_READERS, "jobs-read")
        self._writer = ThreadPoolExecutor(1, "jobs-write")
        self.notifier = JobNotifier()
        self._full_until = 0.0

    @property
    def blocking(self) -> JobStore:
        """The store itself, for work that is on a thread already."""
        return self._store

    @property
    def is_full(self) -> bool:
        """Return whether the disk is full: a write failed within the last minute, and none has succeeded since."""
        return time.monotonic() < self._full_until

    async def read(self, what: Callable[Concatenate[JobStore, P], T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Call a reading method of the store."""
        return await _run_on(self._readers, lambda: what(self._store, *args, **kwargs))

    async def write(self, what: Callable[Concatenate[JobStore, P], T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Call a writing method of the store; notify the listeners of the Job, or of the Jobs, that it returns."""
        try:
            result = await _run_on(self._writer, lambda: what(self._store, *args, **kwargs))
        except DBAPIError as error:
            if fault_of(error) is Fault.FULL:
                self._full_until = time.monotonic() + _FULL_S
            raise
        for job in result if isinstance(result, tuple) else (result,):
            if isinstance(job, Job):
                self._full_until = 0.0
                self.notifier.notify(job.id)
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
