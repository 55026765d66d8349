"""Job queue of a worker: a few slots, a short queue behind them, and the runs that ended in the last ten minutes."""

from __future__ import annotations

import asyncio
import hmac
import logging
from collections import deque
from collections.abc import AsyncIterator
from dataclasses import dataclass

import grpc

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.worker.coded_messages import coded_progress
from capture2vr.edge.worker.event_log import Ending
from capture2vr.edge.worker.failures import CANCELLED, DRAINING, YIELDED
from capture2vr.edge.worker.job_request import ReconstructionRequest, RefusedError
from capture2vr.edge.worker.job_run import JobRun, Work
from capture2vr.edge.worker.metrics import WorkerMetrics
from capture2vr.edge.worker.scratch import Scratch
from capture2vr.edge.worker.upload import receive
from capture2vr.sentences.sentence import say

_log = logging.getLogger(__name__)

KEEP_ENDED_S = 600.0
"""Seconds that the events of an ended run can be read: longer than a gateway takes to restart and find its jobs."""

KEEP_ENDED = 100
"""Most ended runs that are kept; at some hundred events of some hundred bytes each, a few megabytes."""

GIVE_UP_S = 1.5
"""Seconds that a run gets to react to a stop: the wire promises a free slot within two seconds."""


@dataclass(eq=False, slots=True)
class _PendingUpload:
    """A job whose archive is being uploaded: it has its place in the queue, but Attach does not know it yet."""

    request: ReconstructionRequest
    receiving: asyncio.Task[None]
    refusal: RefusedError | None = None

    def refuse(self, refusal: RefusedError) -> None:
        self.refusal = refusal
        self.receiving.cancel()

    async def received(self) -> None:
        """Wait for the whole archive. Raises as `receive`, and the refusal even if that came with the last byte."""
        try:
            await self.receiving
        except asyncio.CancelledError:
            if self.refusal is None:
                raise
        if self.refusal is not None:
            raise self.refusal


class JobQueue:
    """Receives jobs and runs them in `slots` threads, first in, first out. Used on the event loop only."""

    def __init__(self, work: Work, scratch: Scratch, metrics: WorkerMetrics, *, slots: int, queue: int) -> None:
        self._work = work
        self._metrics = metrics
        self._scratch = scratch
        self._checkpoints = scratch.checkpoints
        self._slots = slots
        self._places = slots + queue
        self._runs: dict[str, JobRun] = {}
        self._uploads: dict[str, _PendingUpload] = {}
        self._waiting: deque[JobRun] = deque()
        self._busy: set[JobRun] = set()
        self._ended: deque[JobRun] = deque()
        self._heartbeats: set[asyncio.Task[None]] = set()
        self._idle = asyncio.Event()
        self._idle.set()
        self.draining = False

    @property
    def free_slots(self) -> int:
        return max(0, self._slots - self._places_taken())

    @property
    def queued(self) -> int:
        return max(0, self._places_taken() - self._slots)

    @property
    def live_jobs(self) -> list[str]:
        """Ids of the jobs that take a place: they are being uploaded, wait or run."""
        return sorted({*self._uploads, *(run.request.job for run in (*self._waiting, *self._busy))})

    async def take(self, request: ReconstructionRequest, chunks: AsyncIterator[pb.Chunk], capture_bytes: int) -> JobRun:
        """Receive a job's archive and queue the job. Once this returns, the job no longer depends on its caller.

        Raises RefusedError: UNAVAILABLE, ALREADY_EXISTS, RESOURCE_EXHAUSTED, and those of `receive`.
        """
        self._admit(request)
        folder = self._scratch.folder(capture_bytes)
        archive = folder / "capture.zip"
        receiving = asyncio.create_task(receive(chunks, archive, expected_bytes=capture_bytes))
        upload = _PendingUpload(request, receiving)
        self._uploads[request.job] = upload
        try:
            await upload.received()
        except BaseException:
            self._scratch.drop(folder)
            raise
        finally:
            # A newer upload of the same job may have taken the entry over.
            if self._uploads.get(request.job) is upload:
                del self._uploads[request.job]
        return self._enqueue(JobRun(request, archive, folder, self._checkpoints))

    def find(self, job: str, token: str) -> JobRun | None:
        """Return the job's run, if it waits, runs or ended lately and the token is the job's; else None."""
        run = self._runs.get(job)
        return run if run is not None and _shows_token(run.request, token) else None

    def make_room(self, job: str, token: str) -> bool:
        """Stop a job in its slot that can go on from its checkpoint later; return whether it is such a one."""
        run = self.find(job, token)
        if run is None or run not in self._busy or not run.is_resumable:
            return False
        self._stop(run, YIELDED)
        return True

    def cancel(self, job: str, token: str) -> bool:
        """Stop a job in its upload, the queue or its slot, which is free within two seconds; False for an unknown or
        ended job, and for a token that is not the job's."""
        if (upload := self._uploads.get(job)) is not None and _shows_token(upload.request, token):
            upload.refuse(RefusedError(grpc.StatusCode.CANCELLED, "CANCELLED", say("job_cancelled")))
            return True
        run = self.find(job, token)
        if run is None or run.log.ending is not None:
            return False
        self._stop(run, CANCELLED)
        return True

    async def drain(self, timeout_s: float, hurry: asyncio.Event) -> None:
        """Refuse new jobs and return those that wait; stop those still running after `timeout_s` or on `hurry`."""
        self.draining = True
        self._show_load()
        for upload in self._uploads.values():
            upload.refuse(_draining())
        for run in tuple(self._waiting):
            self._stop(run, DRAINING)
        idle, hurried = asyncio.create_task(self._idle.wait()), asyncio.create_task(hurry.wait())
        await asyncio.wait({idle, hurried}, timeout=timeout_s, return_when=asyncio.FIRST_COMPLETED)
        hurried.cancel()
        for run in tuple(self._busy):
            self._stop(run, DRAINING)
        await idle

    def _places_taken(self) -> int:
        return len(self._waiting) + len(self._busy) + len(self._uploads)

    def _admit(self, request: ReconstructionRequest) -> None:
        """Check whether a job can be taken. Raises RefusedError. An upload of the job by an older lease is aborted."""
        if self.draining:
            raise _draining()
        if (upload := self._uploads.get(request.job)) is not None:
            if upload.request.fence >= request.fence:
                raise _job_known(request.job, "is being uploaded")
            # The older lease's gateway is down or cut off, and its upload will not be used.
            upload.refuse(RefusedError(grpc.StatusCode.ABORTED, "FENCE_STALE", "a newer lease uploads the job"))
            del self._uploads[request.job]
        self._require_unknown(request)
        if self._places_taken() >= self._places:
            status = grpc.StatusCode.RESOURCE_EXHAUSTED
            raise RefusedError(status, "QUEUE_FULL", say("all_places_slots_queue_taken", count=self._places))

    def _require_unknown(self, request: ReconstructionRequest) -> None:
        """Refuse a job that runs or has ended here; one that failed may run again under a higher fence."""
        run = self._runs.get(request.job)
        if run is None:
            return
        if run.log.ending is None:
            raise _job_known(request.job, "is running")
        if isinstance(run.log.ending, pb.Finished) or run.request.fence >= request.fence:
            raise _job_known(request.job, "has ended")

    def _enqueue(self, run: JobRun) -> JobRun:
        if self.draining:
            self._scratch.drop(run.folder)
            raise _draining()
        self._runs[run.request.job] = run
        self._waiting.append(run)
        if len(self._busy) == self._slots:
            run.log.add(coded_progress(say("waiting_slot_number_in_queue", number=len(self._waiting))))
        self._idle.clear()
        heartbeat = asyncio.create_task(run.log.send_heartbeats())
        self._heartbeats.add(heartbeat)
        heartbeat.add_done_callback(self._heartbeats.discard)
        self._fill_slots()
        return run

    def _fill_slots(self) -> None:
        """Start waiting jobs in the free slots."""
        while self._waiting and len(self._busy) < self._slots:
            run = self._waiting.popleft()
            self._busy.add(run)
            request, extra = run.request, {"job": run.request.job}
            _log.info(
                "job %s starts: preset %s, key %s", request.job, request.options.preset, request.asset_key, extra=extra
            )
            self._start(run)
        if not self._waiting and not self._busy:
            self._idle.set()
        self._show_load()

    def _show_load(self) -> None:
        self._metrics.show_load(busy=len(self._busy), queued=len(self._waiting), draining=self.draining)

    def _start(self, run: JobRun) -> None:
        run.start(
            self._work,
            on_end=lambda ending: self._end(run, ending),
            cleanup=lambda: self._scratch.drop(run.folder),
        )

    def _stop(self, run: JobRun, failure: pb.Failure) -> None:
        """End a job that waits, ask one that runs to stop, and give up waiting for it after GIVE_UP_S."""
        if run in self._waiting:
            self._waiting.remove(run)
            run.release_checkpoint(failure)
            self._scratch.drop(run.folder)
            self._end(run, failure)
            return
        run.stop(failure)
        asyncio.get_running_loop().call_later(GIVE_UP_S, self._give_up, run, failure)

    def _give_up(self, run: JobRun, failure: pb.Failure) -> None:
        """Free the slot of a run that has not stopped. Its thread, which is deep in native code, stops at its next
        progress report; its result is discarded."""
        if run.log.ending is None:
            _log.warning(
                "job %s did not stop within %.1f s: its slot is free, its thread still runs", run.request.job, GIVE_UP_S
            )
            self._end(run, failure)

    def _end(self, run: JobRun, ending: Ending) -> None:
        """Record a run's ending, free its slot, and start the next job. Only the first ending of a run counts."""
        if run.log.ending is not None:
            return
        run.log.end(ending)
        self._metrics.observe_end(ending)
        self._busy.discard(run)
        how = ending.code if isinstance(ending, pb.Failure) else "finished"
        _log.info("job %s ended: %s", run.request.job, how, extra={"job": run.request.job})
        self._ended.append(run)
        asyncio.get_running_loop().call_later(KEEP_ENDED_S, self._forget, run)
        if len(self._ended) > KEEP_ENDED:
            self._forget(self._ended[0])
        self._fill_slots()

    def _forget(self, run: JobRun) -> None:
        if run in self._ended:
            self._ended.remove(run)
        # The entry may belong to a newer run: a failed job may run again under a higher fence.
        if self._runs.get(run.request.job) is run:
            del self._runs[run.request.job]


def _shows_token(request: ReconstructionRequest, token: str) -> bool:
    """Return whether a caller shows the job's token; a job of a gateway from before tokens has none."""
    return not request.token or hmac.compare_digest(request.token.encode(), token.encode())


def _draining() -> RefusedError:
    return RefusedError(grpc.StatusCode.UNAVAILABLE, "WORKER_DRAINING", say("worker_shutting_down"))


def _job_known(job: str, state: str) -> RefusedError:
    return RefusedError(grpc.StatusCode.ALREADY_EXISTS, "JOB_KNOWN", f"job {job} {state} here: attach to it")
