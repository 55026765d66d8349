"""One run of a job: the work on its own thread, its events on the loop."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

from services.edge.api import edge_pb2 as pb
from services.edge.checkpoints import Checkpoints
from services.edge.errors import Cancelled
from services.edge.event_log import Ending, EventLog, Said
from services.edge.failures import failure_of
from services.edge.offer import Offer
from services.edge.requests import JobRequest

Say = Callable[[Said], None]
"""How the work speaks, at every slab of it: raises `Cancelled` once the work is no longer wanted (of this worker:
`HandedBack`)."""

PROGRESS_APART_S = 0.25
"""Seconds between two progress events of one stage. The work may speak per slab; people look four times a second."""


class HandedBack(Cancelled):
    """The work is no longer wanted of this worker, but it is wanted: the job will run again, here or elsewhere."""


class Work(Protocol):
    """What a worker does with an archive: blocking, on a thread of its own, several at once when there are slots."""

    @property
    def offer(self) -> Offer:
        """What it can do."""
        ...

    def reconstruct(self, archive: Path, request: JobRequest, scratch: Path, checkpoint: Path, say: Say) -> pb.Finished:
        """Reconstruct and publish, saying `Progress` often and `Published` per bundle; `scratch` is emptied after.

        checkpoint: a file that outlives a killed worker: there when the job's earlier run left one, written by this one
        Raises EdgeError with a name for what the caller should know, Cancelled when `say` does.
        """
        ...

    def inspect(self, archive: Path, scratch: Path) -> pb.Inspection:
        """Read the capture without reconstructing it. Raises EdgeError when it cannot be used."""
        ...


class Run:
    """A job that this worker has taken: its archive lies in `folder`, which is gone when the run's thread is."""

    def __init__(self, request: JobRequest, archive: Path, folder: Path, checkpoints: Checkpoints) -> None:
        self.request = request
        self.folder = folder
        self.log = EventLog(request.job)
        self._archive = archive
        self._checkpoints = checkpoints
        self._stop_with: pb.Failure | None = None
        self._last: tuple[pb.Progress, float] | None = None

    def start(self, work: Work, ended: Callable[[Ending], None], gone: Callable[[], None]) -> None:
        """Run `work` on a new thread. On the loop, `ended` hears the ending; on the thread, `gone` is called last.

        A daemon thread: one that is deep in native code when the worker leaves must not hold the process.
        """
        loop = asyncio.get_running_loop()
        self.log.work_begins()

        def compute() -> None:
            ending = self._ending_of(work, loop)
            self.leave(ending)
            gone()
            _post(loop, ended, ending)

        threading.Thread(target=compute, name=f"job {self.request.job}", daemon=True).start()

    def stop(self, failure: pb.Failure) -> None:
        """Ask the work to stop at its next word, and end with `failure`. The first to ask gives the reason."""
        self._stop_with = self._stop_with or failure

    def leave(self, ending: Ending) -> None:
        """Nothing is computed here any more: what the job would go on from is kept only if it will."""
        if not _runs_again(ending):
            self._checkpoints.drop(self.request.job, self.request.fence)

    def _ending_of(self, work: Work, loop: asyncio.AbstractEventLoop) -> Ending:
        scratch = self.folder / "work"
        try:
            scratch.mkdir()
            checkpoint = self._checkpoints.take(self.request.job, self.request.fence)
            return work.reconstruct(
                self._archive, self.request, scratch, checkpoint, lambda what: self._say(loop, what)
            )
        except Cancelled as cancelled:
            return self._stop_with or failure_of(cancelled, job=self.request.job, scratch=scratch)
        except BaseException as error:  # noqa: BLE001 - whatever kills this thread, the caller must hear of an ending
            return failure_of(error, job=self.request.job, scratch=scratch)

    def _say(self, loop: asyncio.AbstractEventLoop, what: Said) -> None:
        """Called on the run's thread."""
        if self._stop_with is not None:
            raise HandedBack if _runs_again(self._stop_with) else Cancelled
        if isinstance(what, pb.Progress) and self._no_news(what):
            return
        _post(loop, self._hear, what)

    def _hear(self, what: Said) -> None:
        # A run that was given up has its ending already; its thread may still speak once.
        if self.log.ending is None:
            self.log.say(what)

    def _no_news(self, progress: pb.Progress) -> bool:
        """Whether it repeats the last, as work does that waits and only asks to be stopped, or follows it too soon."""
        now = time.monotonic()
        if self._last is not None:
            last, said_at = self._last
            if progress == last or (progress.stage == last.stage and now - said_at < PROGRESS_APART_S):
                return True
        self._last = (progress, now)
        return False


def _runs_again(ending: Ending) -> bool:
    """Whether a gateway will send the job again, to go on from its checkpoint."""
    return isinstance(ending, pb.Failure) and ending.retryable


def _post(loop: asyncio.AbstractEventLoop, call: Callable[[Any], None], what: Said | Ending) -> None:
    """From a run's thread to the loop, in order. A closed loop means that the worker has left without this thread."""
    with suppress(RuntimeError):
        loop.call_soon_threadsafe(call, what)
