"""One run of a job: begin it on a worker or find it again, write down what it reports, and decide what a loss means."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import AsyncGenerator, Callable
from contextlib import aclosing
from dataclasses import dataclass
from functools import partial

from sqlalchemy.exc import SQLAlchemyError

from services.gateway.edge import CHUNK_BYTES, EdgePool
from services.gateway.errors import Problem
from services.gateway.jobs.batches import batched
from services.gateway.jobs.desk import Desk
from services.gateway.jobs.job import Job
from services.gateway.jobs.reports import Beat, Failed, Report
from services.gateway.jobs.source import capture_bytes, capture_chunks
from services.gateway.jobs.transitions import RUNS, Retry, StaleFence, reported, set_back, turned_away
from services.gateway.workers import RunKnown, RunUnknown, WorkerBusy, WorkerLost, WorkerUnreachable
from services.storage.store import Store

_APART_S = 0.2  # between two writes about one run: people see five steps a second, the disk syncs as often
_FIRST_LOOK_S = 0.1  # before looking for a lost run: a worker that restarts needs a second or two
_LAST_LOOK_S = 2.0
_CANCEL_AGAIN_S = 0.5  # a cancellation may be faster than the upload that it is to stop

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Means:
    """What every conductor works with. attach_for_s: how long to look for a lost run before it begins anew."""

    desk: Desk
    edge: EdgePool
    store: Store
    retry: Retry
    attach_for_s: float
    ended: Callable[[Job], None]


class Conductor:
    """Speaks for one lease of a job until the run has ended, is set back, or the lease is lost."""

    def __init__(self, means: Means, job: Job) -> None:
        self.job = job
        self.fence = job.lease.fence
        self.worker = job.lease.worker
        self._means = means
        self._heard = job.lease.run_seq > 0  # whether the worker is known to have begun
        self._canceller: asyncio.Task[None] | None = None

    async def conduct(self, *, running: bool) -> None:
        """From the run's beginning, or where it is `running` already, to its end."""
        try:
            await self._conduct(running)
        except StaleFence as stale:
            _log.info("job %s: %s", self.job.id, stale)
        finally:
            if self._canceller is not None:
                self._canceller.cancel()

    def cancel(self) -> None:
        """Tell the worker to stop, again and again until it has."""
        if self._canceller is None:
            self._canceller = asyncio.create_task(self._cancel())

    async def _conduct(self, running: bool) -> None:
        try:
            if not running and await self._begin():
                return
            await self._find_again()
        except Problem as problem:
            await self._report([_refusal(self.job, problem)])
        except FileNotFoundError:
            gone = Problem(422, "CAPTURE_UNKNOWN", f"the capture {self.job.order.capture} is no longer on the store")
            await self._report([_refusal(self.job, gone)])
        except OSError as error:
            _log.warning("job %s: the store cannot be read: %s", self.job.id, error)
            why = Problem(503, "STORE_UNAVAILABLE", "the capture could not be read from the store", retryable=True)
            await self._set_back(why)
        except (StaleFence, SQLAlchemyError):
            raise
        except Exception:  # noqa: BLE001 - a fault of ours costs an attempt like a lost worker: no job for ever
            _log.exception("job %s: its run cannot be followed", self.job.id)
            await self._set_back(Problem(500, "INTERNAL", "the run could not be followed", retryable=True))

    async def _begin(self) -> bool:
        """Run it; False when the run must be looked for."""
        order, means = self.job.order, self._means
        size = await capture_bytes(means.store, order.capture)
        data = capture_chunks(means.store, order.capture, size, CHUNK_BYTES)
        try:
            await self._follow(means.edge.reconstruct(self.worker, self.job, data, size))
        except WorkerBusy as busy:
            _log.info("job %s: %s turned it away: %s", self.job.id, self.worker, busy)
            await self._turn_away()
        except RunKnown:
            return False
        except WorkerUnreachable as lost:
            _log.warning("job %s: %s", self.job.id, lost)
            return False
        except WorkerLost as lost:
            _log.warning("job %s: %s", self.job.id, lost)
            self._heard = True  # it did answer: a run that it cannot even begin must not be tried for ever
            return False
        return True

    async def _find_again(self) -> None:
        """Attach to the run, patiently; where the worker does not know it or stays away, the run is lost."""
        pause_s, give_up = _FIRST_LOOK_S, time.monotonic() + self._means.attach_for_s
        while True:
            seq = self.job.lease.run_seq
            try:
                await self._follow(self._means.edge.attach(self.worker, self.job.id, seq))
                return
            except RunUnknown:
                break
            except (WorkerBusy, WorkerLost) as lost:
                if self.job.lease.run_seq > seq:
                    pause_s, give_up = _FIRST_LOOK_S, time.monotonic() + self._means.attach_for_s
                elif time.monotonic() > give_up:
                    _log.warning("job %s: giving up on %s: %s", self.job.id, self.worker, lost)
                    break
            await asyncio.sleep(pause_s)
            pause_s = min(_LAST_LOOK_S, 1.5 * pause_s)
        if self._heard:
            await self._set_back(_worker_lost(self.job))
        else:
            await self._turn_away()

    async def _follow(self, reports: AsyncGenerator[Report, None]) -> None:
        """Write down what the worker says until the run is over."""
        async with aclosing(batched(reports, apart_s=_APART_S)) as batches:
            async for batch in batches:
                self._heard = True
                if all(isinstance(report, Beat) for report in batch):
                    continue
                await self._report(batch)
                if self.job.state not in RUNS:
                    return
                if self.job.lease.cancel:
                    self.cancel()

    async def _report(self, reports: list[Report]) -> None:
        transition = partial(reported, fence=self.fence, reports=reports, now=time.time(), retry=self._means.retry)
        self._changed(await self._means.desk.change(self.job.id, transition))

    async def _set_back(self, why: Problem) -> None:
        transition = partial(set_back, fence=self.fence, why=why, now=time.time(), retry=self._means.retry)
        self._changed(await self._means.desk.change(self.job.id, transition))

    async def _turn_away(self) -> None:
        transition = partial(turned_away, fence=self.fence, now=time.time(), pause_s=self._means.retry.pause_s)
        self._changed(await self._means.desk.change(self.job.id, transition))

    def _changed(self, job: Job) -> None:
        if job.state is not self.job.state:
            _log.info("job %s is %s (attempt %d)", job.id, job.state, job.lease.attempts)
        self.job = job
        if job.ended:
            self._means.ended(job)

    async def _cancel(self) -> None:
        while True:
            try:
                if await self._means.edge.cancel(self.worker, self.job.id):
                    return
            except WorkerLost as lost:
                _log.info("job %s: not cancelled yet: %s", self.job.id, lost)
            await asyncio.sleep(_CANCEL_AGAIN_S)


def _refusal(job: Job, problem: Problem) -> Failed:
    """A run that no worker would begin, in the words of one that failed."""
    return Failed(job.lease.run_seq + 1, problem.code, problem.detail, problem.file, problem.hints)


def _worker_lost(job: Job) -> Problem:
    return Problem(
        503,
        "WORKER_LOST",
        f"the worker was lost {job.lease.attempts} times while it ran this job",
        retryable=True,
        stage=job.stage,
        hints=("try again later", "a capture that is too large for the worker's memory ends so too"),
    )
