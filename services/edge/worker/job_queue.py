"""The jobs of a worker: a few slots, a short queue behind them, and a memory of those that ended lately."""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import AsyncIterator
from dataclasses import dataclass

import grpc

from services.edge.api import edge_pb2 as pb
from services.edge.event_log import Ending
from services.edge.failures import CANCELLED, DRAINING
from services.edge.requests import JobRequest, RefusedError
from services.edge.run import Run, Work
from services.edge.scratch import Scratch
from services.edge.upload import receive

_log = logging.getLogger(__name__)

ENDED_KEPT_S = 600.0
"""Seconds that an ended run can be read: longer than a gateway takes to restart and find its jobs again."""

ENDED_KEPT = 100
"""Ended runs kept at most; at some hundred events of some hundred bytes each, a few megabytes."""

GIVE_UP_S = 1.5
"""Seconds that a stopped run gets to notice, within the two seconds in which the wire promises a free slot."""


@dataclass(eq=False, slots=True)
class _Upload:
    """A job on its way in: it has its place in the queue, but is not known to Attach."""

    fence: int
    receiving: asyncio.Task[None]
    refusal: RefusedError | None = None

    def refuse(self, refusal: RefusedError) -> None:
        self.refusal = refusal
        self.receiving.cancel()

    async def received(self) -> None:
        """Wait for the whole archive. Raises what `receive` does, and a refusal even if it came with the last byte."""
        try:
            await self.receiving
        except asyncio.CancelledError:
            if self.refusal is None:
                raise
        if self.refusal is not None:
            raise self.refusal


class Runs:
    """Takes jobs, runs them in `slots` threads, first come first served. Lives on the event loop."""

    def __init__(self, work: Work, scratch: Scratch, *, slots: int, queue: int) -> None:
        self._work = work
        self._scratch = scratch
        self._checkpoints = scratch.checkpoints
        self._slots = slots
        self._places = slots + queue
        self._runs: dict[str, Run] = {}
        self._uploads: dict[str, _Upload] = {}
        self._waiting: deque[Run] = deque()
        self._busy: set[Run] = set()
        self._ended: deque[Run] = deque()
        self._beats: set[asyncio.Task[None]] = set()
        self._idle = asyncio.Event()
        self._idle.set()
        self.draining = False

    @property
    def free_slots(self) -> int:
        return max(0, self._slots - self._taken())

    @property
    def queued(self) -> int:
        return max(0, self._taken() - self._slots)

    @property
    def live(self) -> list[str]:
        """The jobs that can be attached to and have not ended."""
        return sorted(run.request.job for run in (*self._waiting, *self._busy))

    async def take(self, request: JobRequest, chunks: AsyncIterator[pb.Chunk], capture_bytes: int) -> Run:
        """Receive the archive and queue the job. Once this returns, the job no longer depends on its caller.

        Raises RefusedError: UNAVAILABLE, ALREADY_EXISTS, RESOURCE_EXHAUSTED, and those of `receive`.
        """
        self._admit(request)
        folder = self._scratch.folder(capture_bytes)
        archive = folder / "capture.zip"
        upload = _Upload(request.fence, asyncio.create_task(receive(chunks, archive, expected_bytes=capture_bytes)))
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
        return self._enqueue(Run(request, archive, folder, self._checkpoints))

    def find(self, job: str) -> Run | None:
        """A run that lives or ended lately."""
        return self._runs.get(job)

    def cancel(self, job: str) -> bool:
        """Stop a job wherever it is; False when it is not known or has ended. The slot is free within two seconds."""
        if (upload := self._uploads.get(job)) is not None:
            upload.refuse(RefusedError(grpc.StatusCode.CANCELLED, "CANCELLED", "the job was cancelled"))
            return True
        run = self._runs.get(job)
        if run is None or run.log.ending is not None:
            return False
        self._stop(run, CANCELLED)
        return True

    async def drain(self, within_s: float, hurry: asyncio.Event) -> None:
        """Take no more jobs and hand back those that wait; stop those still running after `within_s` or on `hurry`."""
        self.draining = True
        for upload in self._uploads.values():
            upload.refuse(_unavailable())
        for run in tuple(self._waiting):
            self._stop(run, DRAINING)
        idle, hurried = asyncio.create_task(self._idle.wait()), asyncio.create_task(hurry.wait())
        await asyncio.wait({idle, hurried}, timeout=within_s, return_when=asyncio.FIRST_COMPLETED)
        hurried.cancel()
        for run in tuple(self._busy):
            self._stop(run, DRAINING)
        await idle

    def _taken(self) -> int:
        return len(self._waiting) + len(self._busy) + len(self._uploads)

    def _admit(self, request: JobRequest) -> None:
        if self.draining:
            raise _unavailable()
        if (upload := self._uploads.get(request.job)) is not None:
            if upload.fence >= request.fence:
                raise _known(request.job, "is being uploaded")
            # The older lease's gateway is gone or cut off: its half of an upload is worth nothing.
            upload.refuse(RefusedError(grpc.StatusCode.ABORTED, "FENCE_STALE", "a newer lease uploads the job"))
            del self._uploads[request.job]
        self._require_unknown(request)
        if self._taken() >= self._places:
            status = grpc.StatusCode.RESOURCE_EXHAUSTED
            raise RefusedError(status, "QUEUE_FULL", f"all {self._places} places of slots and queue are taken")

    def _require_unknown(self, request: JobRequest) -> None:
        run = self._runs.get(request.job)
        if run is None:
            return
        if run.log.ending is None:
            raise _known(request.job, "is running")
        if isinstance(run.log.ending, pb.Finished) or run.request.fence >= request.fence:
            raise _known(request.job, "has ended")

    def _enqueue(self, run: Run) -> Run:
        if self.draining:
            self._scratch.drop(run.folder)
            raise _unavailable()
        self._runs[run.request.job] = run
        self._waiting.append(run)
        if len(self._busy) == self._slots:
            run.log.say(pb.Progress(message=f"waiting for a slot, number {len(self._waiting)} in the queue"))
        self._idle.clear()
        beat = asyncio.create_task(run.log.beat())
        self._beats.add(beat)
        beat.add_done_callback(self._beats.discard)
        self._fill()
        return run

    def _fill(self) -> None:
        """Give free slots to those who wait."""
        while self._waiting and len(self._busy) < self._slots:
            run = self._waiting.popleft()
            self._busy.add(run)
            _log.info("job %s begins: preset %s, key %s", run.request.job, run.request.preset, run.request.asset_key)
            self._start(run)
        if not self._waiting and not self._busy:
            self._idle.set()

    def _start(self, run: Run) -> None:
        run.start(
            self._work,
            ended=lambda ending: self._end(run, ending),
            gone=lambda: self._scratch.drop(run.folder),
        )

    def _stop(self, run: Run, failure: pb.Failure) -> None:
        if run in self._waiting:
            self._waiting.remove(run)
            run.leave(failure)
            self._scratch.drop(run.folder)
            self._end(run, failure)
            return
        run.stop(failure)
        asyncio.get_running_loop().call_later(GIVE_UP_S, self._give_up, run, failure)

    def _give_up(self, run: Run, failure: pb.Failure) -> None:
        """A thread deep in native code cannot be stopped: it loses its slot, and ends unheard at its next word."""
        if run.log.ending is None:
            _log.warning(
                "job %s did not stop in %.1f s: its thread runs on, its slot is free", run.request.job, GIVE_UP_S
            )
            self._end(run, failure)

    def _end(self, run: Run, ending: Ending) -> None:
        if run.log.ending is not None:
            return
        run.log.end(ending)
        self._busy.discard(run)
        _log.info("job %s ended: %s", run.request.job, ending.code if isinstance(ending, pb.Failure) else "finished")
        self._ended.append(run)
        asyncio.get_running_loop().call_later(ENDED_KEPT_S, self._forget, run)
        if len(self._ended) > ENDED_KEPT:
            self._forget(self._ended[0])
        self._fill()

    def _forget(self, run: Run) -> None:
        if run in self._ended:
            self._ended.remove(run)
        # The job may run again under a higher fence.
        if self._runs.get(run.request.job) is run:
            del self._runs[run.request.job]


def _unavailable() -> RefusedError:
    return RefusedError(grpc.StatusCode.UNAVAILABLE, "WORKER_DRAINING", "the worker is shutting down")


def _known(job: str, state: str) -> RefusedError:
    return RefusedError(grpc.StatusCode.ALREADY_EXISTS, "JOB_KNOWN", f"job {job} {state} here: attach to it")
