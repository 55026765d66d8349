"""Dispatcher: leases queued jobs to free workers, renews the leases of running jobs, takes over orphaned ones."""

from __future__ import annotations

import asyncio
import contextvars
import logging
import random
import time
from collections.abc import Awaitable, Callable, Collection, Mapping, Sequence
from functools import partial

from sqlalchemy.exc import SQLAlchemyError

from capture2vr.gateway.dispatch.run_supervisor import Dependencies, RunSupervisor
from capture2vr.gateway.jobs.job import Job
from capture2vr.gateway.jobs.state_machine import lease_to_worker, take_over
from capture2vr.gateway.jobs.store import JobStore, NextJob, Slot, SlotTaken
from capture2vr.gateway.waiting import happens_within
from capture2vr.gateway.workers.worker_types import WorkerStatus

_POLL_S = 0.5  # between checks of the queue without a wake-up: another gateway may queue jobs
_WORKERS_S = 2.0  # between polls of workers that are away, and of those with free slots while jobs wait
_ASKED_FIRST = 3  # workers: mostly the first has a free slot, as the lease table says
_ANNOUNCED_POLL_S = 30.0  # where the database notifies of queued jobs; only a safety net
_RESUMABLE_STAGE = "FITTING"  # the one with checkpoints
# Of a run, after which it yields to a job that has not run yet, and to one that has. Its points are made anew then.
_SLICE_S, _LONG_SLICE_S = 60.0, 900.0
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
        self._is_stopped = False
        self._idle_s = _ANNOUNCED_POLL_S if dependencies.job_store.blocking.announces else _POLL_S

    def wake(self) -> None:
        """Check the queue now: there is a new job."""
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
                group.create_task(self._repeat(self._find_workers, asyncio.Event()))
                group.create_task(self._repeat(self._dispatch, self._wake))
        finally:
            self._is_stopped = True
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
            await happens_within(wake, seconds)

    async def _dispatch(self) -> float:
        """Lease queued jobs to workers until the queue or the free slots are used up.

        Of the workers with slots that are not leased, only those with the fewest runs are asked first, and the others
        only where jobs are left. Returns the seconds until the queue is to be checked again without a wake-up.
        """
        asked: set[str] = set()
        while True:
            now = time.time()
            queue = await self._dependencies.job_store.read(JobStore.queue_state, now)
            if queue.start is None or queue.start > now:
                return self._idle_s if queue.start is None else min(queue.start - now, self._idle_s)
            addresses = self._with_free_slots(queue.taken, asked)
            if not addresses:
                await self._make_room(now)
                return _WORKERS_S
            asked.update(addresses)
            await self._fill(await self._dependencies.workers.poll(addresses))

    async def _make_room(self, now: float) -> None:
        """Have a run that was long on its worker yield to a job that waits, at its checkpoint.

        It yields early to a job that has not run yet, and late to one that yielded itself: each time, its points are
        made anew.
        """
        running = (supervisor for supervisor, _ in self._supervisors.values() if supervisor.ran_s > _SLICE_S)
        for supervisor in sorted(running, key=lambda each: -each.ran_s):
            worker = self._dependencies.workers.last_status(supervisor.worker)
            if worker is None or not worker.takes_jobs or supervisor.job.stage != _RESUMABLE_STAGE:
                continue
            store, has_run = self._dependencies.job_store, supervisor.ran_s > _LONG_SLICE_S
            waits = await store.read(JobStore.waits, now, worker.preset_names, has_run=has_run)
            if waits and await supervisor.make_room():
                _log.info("job %s yields its slot after %.0f s: others wait", supervisor.job.id, supervisor.ran_s)
                return

    def _with_free_slots(self, taken: Mapping[str, int], asked: Collection[str]) -> list[str]:
        """Return the workers that the lease table has free slots of, the few with the fewest runs if none was `asked`.

        Of workers with equally many the order is random, so that gateways do not contend for the same one.
        """
        workers = self._dependencies.workers
        known = {address: workers.last_status(address) for address in workers.addresses if address not in asked}
        free = [
            address
            for address, status in known.items()
            if status is not None and status.takes_jobs and taken.get(address, 0) < status.slots
        ]
        if asked:
            return free
        random.shuffle(free)
        return sorted(free, key=lambda address: taken.get(address, 0))[:_ASKED_FIRST]

    async def _fill(self, workers: Sequence[WorkerStatus]) -> None:
        """Lease queued jobs to the free slots of these workers."""
        taken: set[str] = set()
        nothing_for: set[frozenset[str]] = set()  # presets without a job
        while ready := [
            worker
            for worker in self._free_workers(workers)
            if worker.address not in taken and worker.preset_names not in nothing_for
        ]:
            worker, which = ready[0], self._next_job(ready[0])
            write = self._dependencies.job_store.write
            try:
                job = await write(JobStore.claim, which.now, which.presets, which.lease, which.slot)
            except SlotTaken:
                taken.add(worker.address)
                continue
            if job is None:
                nothing_for.add(worker.preset_names)
            else:
                self._start(job, running=False)

    async def _find_workers(self) -> float:
        """Ask the workers that did not answer when they were asked last, or took no jobs; dispatch if one does now.

        Returns the seconds until they are to be asked again.
        """
        workers = self._dependencies.workers
        statuses = {address: workers.last_status(address) for address in await workers.look_up()}
        away = [address for address, status in statuses.items() if status is None or not status.takes_jobs]
        if away and any(status.takes_jobs for status in await workers.poll(away)):
            self._wake.set()
        return _WORKERS_S

    def next_job(self, worker: str) -> NextJob | None:
        """Return which job may run next on a worker; None for one that is not known, or takes no jobs.

        Its presets are still those of its last status: a run that ended was on the process which gave that.
        """
        status = self._dependencies.workers.last_status(worker)
        return self._next_job(status) if status is not None and status.takes_jobs else None

    def _next_job(self, worker: WorkerStatus) -> NextJob:
        now = time.time()
        lease = partial(lease_to_worker, holder=self._holder, worker=worker.address, now=now, lease_s=self._lease_s)
        return NextJob(Slot(worker.address, worker.slots), worker.preset_names, now, lease)

    def _free_workers(self, workers: Sequence[WorkerStatus]) -> list[WorkerStatus]:
        """Return the workers with a free slot, shortest queue first.

        Jobs that were given to a worker after it reported its status count as used slots.
        """

        def free(worker: WorkerStatus) -> int:
            own_runs = {
                job for job, (supervisor, _) in self._supervisors.items() if supervisor.worker == worker.address
            }
            return worker.free_slots - len(own_runs - worker.jobs)

        ready = [worker for worker in workers if worker.takes_jobs and free(worker) > 0]
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

    def start(self, job: Job) -> None:
        """Start the run of a job that was leased with the end of another; a restarted gateway finds it by its lease."""
        if not self._is_stopped:
            self._start(job, running=False)

    def _start(self, job: Job, *, running: bool) -> None:
        if not running:
            _log.info("job %s is given to worker %s (attempt %d)", job.id, job.lease.worker, job.lease.attempts)
            self._dependencies.watch.leased(job)
        supervisor = RunSupervisor(self._dependencies, job, self)
        # Nothing of the job that ended on this slot: neither its log fields nor its span.
        task = asyncio.create_task(
            supervisor.supervise(running=running), name=f"supervise {job.id}", context=contextvars.Context()
        )
        self._supervisors[job.id] = (supervisor, task)
        task.add_done_callback(partial(self._on_run_ended, job.id))
        if job.lease.cancel:
            supervisor.cancel()

    def _on_run_ended(self, job: str, task: asyncio.Task[None]) -> None:
        mine = self._supervisors.get(job)
        if mine is not None and mine[1] is task:
            del self._supervisors[job]
        if not task.cancelled() and (error := task.exception()):
            # Its lease expires, and the first gateway to notice takes the run over.
            _log.error("job %s: its run supervisor failed; it is taken over when its lease ends", job, exc_info=error)
        if mine is None or not mine[0].handed_over:
            self._wake.set()
