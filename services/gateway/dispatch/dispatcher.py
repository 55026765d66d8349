"""Dispatcher: leases queued jobs to free workers, renews the leases of running jobs, takes over orphaned ones."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable, Sequence
from functools import partial

from sqlalchemy.exc import SQLAlchemyError

from services.gateway.dispatch.run_supervisor import Dependencies, RunSupervisor
from services.gateway.jobs.job import Job
from services.gateway.jobs.state_machine import lease_to_worker, take_over
from services.gateway.jobs.store import JobStore, Slot, SlotTaken
from services.gateway.worker_types import WorkerStatus

_POLL_S = 0.5  # between checks of the queue without a wake-up: another gateway may queue jobs
_WORKERS_S = 2.0  # between polls of all workers while jobs wait: some come, or are freed by another gateway
_ANNOUNCED_POLL_S = 30.0  # where the database notifies of queued jobs; only a safety net
_DATABASE_FAILED = "the jobs database cannot be used; trying again: %s"
_RENEWALS = 3  # per lease period: two may fail before the lease is lost

_log = logging.getLogger(__name__)


class Dispatcher:
    """Runs the gateway's jobs on its workers, as a background task.

    holder   this gateway's id in the lease table, the same after a restart
    lease_s  how long a lease lasts without renewal
    """

    def __init__(self, dependencies: Dependencies, *, holder: str, lease_s: float) -> None:
        self._dependencies = dependencies
        self._holder = holder
        self._lease_s = lease_s
        self._supervisors: dict[str, tuple[RunSupervisor, asyncio.Task[None]]] = {}
        self._wake = asyncio.Event()
        self._freed: set[str] = set()  # workers on which a run has ended since the queue was checked
        self._poll_all_at = 0.0  # monotonic seconds
        self._idle_s = _ANNOUNCED_POLL_S if dependencies.job_store.blocking.announces else _POLL_S

    def wake(self) -> None:
        """Check the queue now: there is a new job."""
        self._poll_all_at = 0.0
        self._wake.set()

    def cancel(self, job: str) -> None:
        """Stop a job's run if this gateway supervises it; another gateway stops its run when it renews the lease."""
        if job in self._supervisors:
            self._supervisors[job][0].cancel()

    async def run(self) -> None:
        """Dispatch jobs until cancelled. Runs continue on their workers without this gateway."""
        try:
            await self._recover_own_runs()
            async with asyncio.TaskGroup() as group:
                group.create_task(self._repeat(self._renew, asyncio.Event()))
                group.create_task(self._repeat(self._dispatch, self._wake))
        finally:
            tasks = [task for _, task in self._supervisors.values()]
            for task in tasks:
                task.cancel()
            if tasks:
                await asyncio.wait(tasks)

    async def _recover_own_runs(self) -> None:
        """Take over the runs of this gateway before its restart, without waiting for their leases to expire."""
        while True:
            try:
                return await self._take_over(self._holder)
            except SQLAlchemyError as error:
                _log.warning(_DATABASE_FAILED, error.__cause__ or error)
                await asyncio.sleep(_POLL_S)

    async def _repeat(self, do: Callable[[], Awaitable[float]], wake: asyncio.Event) -> None:
        """Call `do` again after the seconds that it returns, and at once when `wake` is set.

        Exceptions are logged; the loop goes on.
        """
        while True:
            wake.clear()
            seconds = _POLL_S
            try:
                seconds = await do()
            except SQLAlchemyError as error:
                _log.warning(_DATABASE_FAILED, error.__cause__ or error)
            except Exception:  # noqa: BLE001 - whatever failed, the dispatcher must go on
                _log.exception("the dispatcher failed; trying again")
            try:
                await asyncio.wait_for(wake.wait(), seconds)
            except TimeoutError:
                continue

    async def _dispatch(self) -> float:
        """Lease queued jobs to workers until the queue or the free slots are used up.

        Returns the seconds until the queue is to be checked again without a wake-up.
        """
        now = time.time()
        start = now if self._freed else await self._dependencies.job_store.read(JobStore.next_start, now)
        if start is None or start > now:
            return self._idle_s if start is None else min(start - now, self._idle_s)
        workers = await self._poll()
        taken: set[str] = set()
        nothing_for: set[frozenset[str]] = set()  # presets without a job
        while ready := [
            worker
            for worker in self._free_workers(workers)
            if worker.address not in taken and worker.preset_names not in nothing_for
        ]:
            worker, now = ready[0], time.time()
            lease = partial(lease_to_worker, holder=self._holder, worker=worker.address, now=now, lease_s=self._lease_s)
            slot = Slot(worker.address, worker.slots)
            try:
                job = await self._dependencies.job_store.write(JobStore.claim, now, worker.preset_names, lease, slot)
            except SlotTaken:
                taken.add(worker.address)
                continue
            if job is None:
                nothing_for.add(worker.preset_names)
            else:
                self._start(job, running=False)
        return _WORKERS_S

    async def _poll(self) -> Sequence[WorkerStatus]:
        """Poll the workers on which a run has just ended; all of them for a new job, and now and then."""
        freed, self._freed = self._freed, set()
        now = time.monotonic()
        if freed and now < self._poll_all_at:
            return await self._dependencies.workers.poll(freed)
        self._poll_all_at = now + _WORKERS_S
        return await self._dependencies.workers.poll()

    def _free_workers(self, workers: Sequence[WorkerStatus]) -> list[WorkerStatus]:
        """Return the workers with a free slot, shortest queue first.

        Jobs that were given to a worker after it reported its status count as used slots.
        """

        def free(worker: WorkerStatus) -> int:
            own_runs = {
                job for job, (supervisor, _) in self._supervisors.items() if supervisor.worker == worker.address
            }
            return worker.free_slots - len(own_runs - worker.jobs)

        usable = [worker for worker in workers if worker.is_compatible and not worker.draining]
        ready = [worker for worker in usable if free(worker) > 0]
        return sorted(ready, key=lambda worker: (worker.queued, -free(worker)))

    async def _renew(self) -> float:
        """Renew this gateway's leases, drop lost ones, pass on cancellations, take over orphaned runs of others.

        Returns the seconds until the next renewal.
        """
        own_runs = dict(self._supervisors)
        if own_runs:
            until = time.time() + self._lease_s
            fences = [(job, supervisor.fence) for job, (supervisor, _) in own_runs.items()]
            job_store = self._dependencies.job_store
            lost_jobs, cancelled_jobs = await job_store.write(JobStore.renew, self._holder, until, fences)
            for job in lost_jobs:  # perhaps ended meanwhile, or leased again: so cancel only the task of the old lease
                own_runs[job][1].cancel()
            for job in cancelled_jobs:
                self.cancel(job)
        await self._take_over("")
        return self._lease_s / _RENEWALS

    async def _take_over(self, holder: str) -> None:
        """Take over running jobs whose lease has expired, and all those whose lease belongs to `holder`."""
        while True:
            now = time.time()
            transition = partial(take_over, holder=self._holder, now=now, lease_s=self._lease_s)
            own_runs = tuple(self._supervisors)
            job = await self._dependencies.job_store.write(JobStore.claim_orphan, now, holder, own_runs, transition)
            if job is None:
                return
            _log.info("job %s: reattaching to its run on %s", job.id, job.lease.worker)
            self._start(job, running=True)

    def _start(self, job: Job, *, running: bool) -> None:
        supervisor = RunSupervisor(self._dependencies, job)
        task = asyncio.create_task(supervisor.supervise(running=running), name=f"supervise {job.id}")
        self._supervisors[job.id] = (supervisor, task)
        task.add_done_callback(partial(self._on_run_ended, job.id))
        if job.lease.cancel:
            supervisor.cancel()

    def _on_run_ended(self, job: str, task: asyncio.Task[None]) -> None:
        if (mine := self._supervisors.get(job)) is not None and mine[1] is task:
            del self._supervisors[job]
            self._freed.add(mine[0].worker)
        if not task.cancelled() and (error := task.exception()):
            # Its lease expires, and the first gateway to notice takes the run over.
            _log.error("job %s: its run supervisor failed; it is taken over when its lease ends", job, exc_info=error)
        self._wake.set()
