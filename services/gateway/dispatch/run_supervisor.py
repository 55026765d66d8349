"""Supervises one run of a job: start it on a worker or reattach to it, store its reports, requeue the job if lost."""

from __future__ import annotations

import asyncio
import errno
import logging
import time
from collections.abc import AsyncGenerator, Callable
from contextlib import aclosing
from dataclasses import dataclass
from functools import partial
from typing import Protocol

from sqlalchemy.exc import SQLAlchemyError

from capture2vr.gateway.dispatch.batching import batch_reports
from capture2vr.gateway.dispatch.job_watch import JobWatch
from capture2vr.gateway.errors import Problem
from capture2vr.gateway.jobs.async_store import AsyncJobStore
from capture2vr.gateway.jobs.capture_objects import capture_bytes, capture_name, object_chunks
from capture2vr.gateway.jobs.job import Job
from capture2vr.gateway.jobs.reports import DRAINING, Report, RunFailed, RunFinished, RunHeartbeat
from capture2vr.gateway.jobs.state_machine import (
    RUNNING_STATES,
    Change,
    LeaseLost,
    Retry,
    apply_reports,
    requeue_lost,
    requeue_refused,
)
from capture2vr.gateway.jobs.store import JobStore, NextJob
from capture2vr.gateway.workers.worker_client import CHUNK_BYTES, WorkerPool
from capture2vr.gateway.workers.worker_types import (
    RunKnown,
    RunOutOfMemory,
    RunUnknown,
    WorkerBusy,
    WorkerLost,
    WorkerUnreachable,
)
from capture2vr.process.logs import log_fields
from capture2vr.process.traces import capture_span
from capture2vr.sentences.sentence import say
from capture2vr.storage.store import Store
from capture2vr.storage.tenant_store import store_of_tenant

_BATCH_INTERVAL_S = 0.2  # between two writes about one run: people see five steps a second, the disk syncs as often
_GATHER_S = 0.005  # a worker reports the version that it published and the end of its run one after the other
_CANCEL_RETRY_S = 0.5  # a cancellation may arrive before the upload of the run that it should stop

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Dependencies:
    """Services that every run supervisor uses.

    attach_for_s  how long to try to reattach to a lost run before the job is queued again
    watch         hears of what becomes of jobs
    """

    job_store: AsyncJobStore
    workers: WorkerPool
    store: Store
    retry: Retry
    attach_for_s: float
    watch: JobWatch


class NextRun(Protocol):
    """What runs on a worker's slot behind a run that ends: which job may, and its start once that is leased."""

    def next_job(self, worker: str) -> NextJob | None:
        """Return which job may run next on the worker of this address; None where too little is known of it."""
        ...

    def start(self, job: Job) -> None:
        """Start the run of a job that has been leased."""
        ...


class RunSupervisor:
    """Supervises one lease of a job until the run has ended, the job is queued again, or the lease is lost.

    handed_over  whether the slot has its next job: it was leased with the end of this run
    """

    def __init__(self, dependencies: Dependencies, job: Job, behind: NextRun) -> None:
        self.job = job
        self.handed_over = False
        self._behind = behind
        self.fence = job.lease.fence
        self.worker = job.lease.worker
        self._dependencies = dependencies
        self._run_started = job.lease.run_seq > 0  # whether the worker is known to have started the run
        self._canceller: asyncio.Task[None] | None = None
        self._began = time.monotonic()

    async def supervise(self, *, running: bool) -> None:
        """Start the run, or reattach if it is `running` already, and follow it to its end."""
        job = self.job
        with log_fields(job=job.id, tenant=job.tenant), capture_span("run job", job.order.capture, job=job.id):
            try:
                await self._supervise(running)
            except LeaseLost as stale:
                _log.info("job %s: %s", self.job.id, stale)
            finally:
                if self._canceller is not None:
                    self._canceller.cancel()

    @property
    def ran_s(self) -> float:
        """Seconds since this run was begun or reattached to."""
        return time.monotonic() - self._began

    async def make_room(self) -> bool:
        """Have the run yield its slot, if it can go on from a checkpoint later. Returns whether it does."""
        try:
            return await self._dependencies.workers.make_room(self.worker, self.job)
        except WorkerLost:
            return False

    def cancel(self) -> None:
        """Ask the worker to stop the run, repeatedly, until it has stopped."""
        if self._canceller is None:
            self._canceller = asyncio.create_task(self._cancel())

    async def _supervise(self, running: bool) -> None:
        try:
            if not running and await self._start_run():
                return
            await self._reattach()
        except Problem as problem:
            await self._report([_refusal(self.job, problem)])
        except FileNotFoundError:
            detail = say("capture_no_longer_on_store", capture=self.job.order.capture)
            missing = Problem(422, "CAPTURE_UNKNOWN", detail, hints=(say("upload_capture_again"),))
            await self._report([_refusal(self.job, missing)])
        except OSError as error:
            _log.warning("job %s: the store cannot be read: %s", self.job.id, error)
            if error.errno == errno.EIO:  # of a disk that cannot read this very capture
                detail = say("capture_cannot_be_read")
                await self._requeue_lost(Problem(503, "STORE_UNAVAILABLE", detail, retryable=True))
            else:  # No attempt: all jobs that wait would use theirs up while a store restarts.
                await self._requeue_refused()
        except (LeaseLost, SQLAlchemyError):
            raise
        except Exception:  # noqa: BLE001 - a bug here costs an attempt, as a lost worker does: no job retries for ever
            _log.exception("job %s: an internal error stopped its supervision", self.job.id)
            detail = say("internal_error_gateway_stopped_supervision")
            await self._requeue_lost(Problem(500, "INTERNAL", detail, retryable=True))

    async def _start_run(self) -> bool:
        """Start the run and follow it. Returns False where the connection was lost or the run exists: then reattach."""
        capture, dependencies = self.job.order.capture, self._dependencies
        store = store_of_tenant(dependencies.store, self.job.tenant)
        size = await capture_bytes(store, capture)
        data = object_chunks(store, capture_name(capture), 0, size, CHUNK_BYTES)
        try:
            await self._follow(dependencies.workers.reconstruct(self.worker, self.job, data, size))
        except WorkerBusy as busy:
            _log.info("job %s: worker %s is busy: %s", self.job.id, self.worker, busy)
            await self._requeue_refused()
        except RunKnown:
            return False
        except WorkerUnreachable as error:
            _log.warning("job %s: %s", self.job.id, error)
            return False
        except WorkerLost as error:
            _log.warning("job %s: %s", self.job.id, error)
            self._run_started = True  # the worker did answer: counts as an attempt, else it would be retried for ever
            return False
        return True

    async def _reattach(self) -> None:
        """Reattach to the run; where the worker does not know it or does not answer in time, the run is lost."""
        dependencies, lease = self._dependencies, self.job.lease
        try:
            await self._follow(
                dependencies.workers.follow(self.worker, self.job, lease.run_seq, dependencies.attach_for_s)
            )
        except (RunUnknown, WorkerBusy, WorkerLost) as error:
            _log.warning("job %s: its run on %s is lost: %s", self.job.id, self.worker, error)
            if self._run_started:
                await self._requeue_lost(_worker_lost(self.job, out_of_memory=isinstance(error, RunOutOfMemory)))
            else:
                await self._requeue_refused()

    async def _follow(self, reports: AsyncGenerator[Report, None]) -> None:
        """Store the worker's reports until the run has ended."""
        batches_of = partial(batch_reports, gather_s=_GATHER_S, interval_s=_BATCH_INTERVAL_S)
        async with aclosing(batches_of(reports)) as batches:
            async for batch in batches:
                self._run_started = True
                if all(isinstance(report, RunHeartbeat) for report in batch):
                    continue
                await self._report(batch)
                if self.job.state not in RUNNING_STATES:
                    return
                if self.job.lease.cancel:
                    self.cancel()

    async def _report(self, reports: list[Report]) -> None:
        transition = partial(
            apply_reports, fence=self.fence, reports=reports, now=time.time(), retry=self._dependencies.retry
        )
        following = self._behind.next_job(self.worker) if _end_run(reports) else None
        if following is None:
            self._record_change(await self._dependencies.job_store.change(self.job.id, transition))
        else:  # Cancelled in the middle, the next job would be leased and nobody start it.
            self._record_change(await asyncio.shield(self._hand_over(transition, following)))

    async def _hand_over(self, transition: Callable[[Job], Change], following: NextJob) -> Job:
        """Store the end of the run, and start the next job on its slot."""
        job_store = self._dependencies.job_store
        try:
            job, found = await job_store.write(JobStore.end_run, self.job.id, transition, following)
        except LeaseLost:
            raise
        except Exception:  # noqa: BLE001 - the end of this run does not depend on the next job
            _log.exception("job %s: its end is stored without leasing the next job", self.job.id)
            return await job_store.change(self.job.id, transition)
        if found is not None:
            self.handed_over = True
            self._behind.start(found)
        return job

    async def _requeue_lost(self, why: Problem) -> None:
        self._dependencies.watch.run_lost(self.job)
        transition = partial(requeue_lost, fence=self.fence, why=why, now=time.time(), retry=self._dependencies.retry)
        self._record_change(await self._dependencies.job_store.change(self.job.id, transition))

    async def _requeue_refused(self) -> None:
        # A longer pause each time: no worker may have room for this capture for days, and each try is an event.
        pause_s = self._dependencies.retry.pause_after(1 + self.job.lease.refusals)
        transition = partial(requeue_refused, fence=self.fence, now=time.time(), pause_s=pause_s)
        self._record_change(await self._dependencies.job_store.change(self.job.id, transition))

    def _record_change(self, job: Job) -> None:
        if job.state is not self.job.state:
            _log.info("job %s is %s (attempt %d)", job.id, job.state, job.lease.attempts)
        before, self.job = self.job, job
        self._dependencies.watch.changed(before, job)

    async def _cancel(self) -> None:
        while True:
            try:
                if await self._dependencies.workers.cancel(self.worker, self.job):
                    return
            except WorkerLost as error:
                _log.info("job %s: not cancelled yet, trying again: %s", self.job.id, error)
            await asyncio.sleep(_CANCEL_RETRY_S)


def _end_run(reports: list[Report]) -> bool:
    """End the run; return whether its slot is free again. A worker that shuts down takes no more jobs."""
    last = reports[-1]
    return isinstance(last, RunFinished) or (isinstance(last, RunFailed) and last.code != DRAINING)


def _refusal(job: Job, problem: Problem) -> RunFailed:
    """Turn a problem that prevents a run from starting into the report of a failed run."""
    return RunFailed(job.lease.run_seq + 1, problem.code, problem.detail, problem.file, problem.hints)


def _worker_lost(job: Job, *, out_of_memory: bool) -> Problem:
    """The problem of a job whose worker is gone. out_of_memory: whether the kernel killed the worker for that"""
    times = say("times_while_ran_job", count=job.lease.attempts)
    detail = say("connection_to_worker_lost", times=times)
    hint = say("send_smaller_capture_one_too_large")
    if out_of_memory:
        detail = say("worker_lost_last_time_because", times=times)
        hint = say("send_smaller_capture_choose_coarser")
    return Problem(503, "WORKER_LOST", detail, retryable=True, stage=job.stage, hints=(say("try_again_later"), hint))
