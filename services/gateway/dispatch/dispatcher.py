"""Gives waiting jobs to free workers, speaks for those that run, and takes over those that nobody speaks for."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable, Sequence
from functools import partial

from sqlalchemy.exc import SQLAlchemyError

from services.gateway.jobs.conductor import Conductor, Means
from services.gateway.jobs.job import Job
from services.gateway.jobs.store import JobStore
from services.gateway.jobs.transitions import Change, leased, taken_over
from services.gateway.workers import WorkerStatus

_LOOK_S = 0.5  # between looks at the queue while nothing wakes us: pauses end, workers come back
_RENEWALS = 3  # per lease: two may fail before the job is lost

_log = logging.getLogger(__name__)


class Dispatcher:
    """The gateway's hands. holder: this gateway's name in the lease table, the same after a restart."""

    def __init__(self, means: Means, *, holder: str, lease_s: float) -> None:
        self._means = means
        self._holder = holder
        self._lease_s = lease_s
        self._conductors: dict[str, tuple[Conductor, asyncio.Task[None]]] = {}
        self._wake = asyncio.Event()

    def wake(self) -> None:
        """There may be something to do: a new job, a free slot."""
        self._wake.set()

    def cancel(self, job: str) -> None:
        """Stop a run that this gateway speaks for; another gateway's is stopped at its next renewal."""
        if job in self._conductors:
            self._conductors[job][0].cancel()

    async def run(self) -> None:
        """Until cancelled. Runs go on without us: their workers do not need to be heard."""
        try:
            await self._take_up()
            async with asyncio.TaskGroup() as group:
                group.create_task(self._every(self._lease_s / _RENEWALS, self._renew, asyncio.Event()))
                group.create_task(self._every(_LOOK_S, self._hand_out, self._wake))
        finally:
            tasks = [task for _, task in self._conductors.values()]
            for task in tasks:
                task.cancel()
            if tasks:
                await asyncio.wait(tasks)

    async def _take_up(self) -> None:
        """What this gateway ran before its restart is still running, or has to run again: no waiting for leases."""
        while True:
            try:
                return await self._take_over(self._holder)
            except SQLAlchemyError:
                _log.exception("the jobs database failed")
                await asyncio.sleep(_LOOK_S)

    async def _every(self, seconds: float, do: Callable[[], Awaitable[None]], wake: asyncio.Event) -> None:
        """Do it now and then, and at once when woken; what fails is tried again."""
        while True:
            wake.clear()
            try:
                await do()
            except Exception:  # noqa: BLE001 - whatever failed, jobs must go on being handed out
                _log.exception("the dispatcher stumbled")
            try:
                await asyncio.wait_for(wake.wait(), seconds)
            except TimeoutError:
                continue

    async def _hand_out(self) -> None:
        """Lease waiting jobs to workers as long as there are both."""
        if not await self._means.desk.read(JobStore.waiting, time.time()):
            return
        workers = await self._means.edge.workers()
        while ready := self._ready(workers):
            now = time.time()
            presets = {preset.name for worker in ready for preset in worker.presets}
            transition = partial(_leased_to, ready, holder=self._holder, now=now, lease_s=self._lease_s)
            job = await self._means.desk.write(JobStore.claim, now, presets, transition)
            if job is None:
                return
            self._start(job, running=False)

    def _ready(self, workers: Sequence[WorkerStatus]) -> list[WorkerStatus]:
        """Those with a free slot, the shortest queue first. What we gave one since it was asked counts as taken."""

        def free(worker: WorkerStatus) -> int:
            ours = {job for job, (conductor, _) in self._conductors.items() if conductor.worker == worker.address}
            return worker.free_slots - len(ours - worker.jobs)

        ready = [worker for worker in workers if not worker.draining and free(worker) > 0]
        return sorted(ready, key=lambda worker: (worker.queued, -free(worker)))

    async def _renew(self) -> None:
        """Prolong our leases, let go of those we lost, pass on cancellations, look for runs left alone by others."""
        ours = dict(self._conductors)
        if ours:
            until = time.time() + self._lease_s
            fences = [(job, conductor.fence) for job, (conductor, _) in ours.items()]
            lost, unwanted = await self._means.desk.write(JobStore.renew, self._holder, until, fences)
            for job in lost:  # or ended meanwhile, and perhaps leased anew: only the task that we asked about must go
                ours[job][1].cancel()
            for job in unwanted:
                self.cancel(job)
        await self._take_over("")

    async def _take_over(self, holder: str) -> None:
        """Speak for runs whose lease has run out, and for all that `holder` held."""
        while True:
            now = time.time()
            transition = partial(taken_over, holder=self._holder, now=now, lease_s=self._lease_s)
            ours = tuple(self._conductors)
            job = await self._means.desk.write(JobStore.claim_orphan, now, holder, ours, transition)
            if job is None:
                return
            _log.info("job %s: looking for its run on %s", job.id, job.lease.worker)
            self._start(job, running=True)

    def _start(self, job: Job, *, running: bool) -> None:
        conductor = Conductor(self._means, job)
        task = asyncio.create_task(conductor.conduct(running=running), name=f"conduct {job.id}")
        self._conductors[job.id] = (conductor, task)
        task.add_done_callback(partial(self._done, job.id))
        if job.lease.cancel:
            conductor.cancel()

    def _done(self, job: str, task: asyncio.Task[None]) -> None:
        if self._conductors.get(job, (None, None))[1] is task:
            del self._conductors[job]
        if not task.cancelled() and (error := task.exception()):
            # Its lease runs out, and whoever sees that first looks for the run again.
            _log.error("job %s: its conductor failed", job, exc_info=error)
        self.wake()


def _leased_to(ready: Sequence[WorkerStatus], job: Job, *, holder: str, now: float, lease_s: float) -> Change:
    """Give a job to the first of these workers that offers its preset; one of them does."""
    worker = next(worker for worker in ready if worker.offers(job.order.preset))
    return leased(job, holder=holder, worker=worker.address, now=now, lease_s=lease_s)
