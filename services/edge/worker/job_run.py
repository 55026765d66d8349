"""One run of a job: the work runs on a thread of its own, its events are logged on the event loop."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.arrays import Tick
from capture2vr.edge.errors import Cancelled
from capture2vr.edge.worker.capabilities import Capabilities
from capture2vr.edge.worker.checkpoint_files import CheckpointFiles
from capture2vr.edge.worker.event_log import Ending, EventLog, Update
from capture2vr.edge.worker.failures import failure_of, internal
from capture2vr.edge.worker.job_request import ReconstructionRequest
from capture2vr.order.photo_box import PhotoBox
from capture2vr.process.logs import log_fields
from capture2vr.process.traces import StageSpans, capture_span, stage_spans
from capture2vr.storage.catalogue.downloads import DownloadOrder, StoredDownload

_log = logging.getLogger(__name__)

Report = Callable[[Update], None]
"""Callback with which the work reports progress, anchor points and published bundles, several times a second; where it
has no news, an empty `Progress`. Raises `Cancelled` once the job is cancelled, `JobReturned` when this worker shuts
down."""

PROGRESS_APART_S = 0.25
"""Least seconds between two progress events of one stage: the work reports more often than people can read."""


class JobReturned(Cancelled):
    """The run is stopped on this worker, but the job is not cancelled: it will run again, here or elsewhere."""


class Work(Protocol):
    """The computation that a worker runs on archives. Methods block; each slot calls them on a thread of its own."""

    @property
    def offer(self) -> Capabilities:
        """The presets, device and options that it has now."""
        ...

    def reconstruct(
        self, archive: Path, request: ReconstructionRequest, scratch: Path, checkpoint: Path, report: Report
    ) -> pb.Finished:
        """Reconstruct and publish; report `Progress` often, `AnchorPoints` once, `Published` for every bundle.

        scratch     folder for temporary files, emptied afterwards
        checkpoint  file that survives a killed worker: it exists where an earlier run of the job wrote it
        Raises EdgeError for faults that the caller should know, and Cancelled when `report` does.
        """
        ...

    def inspect(self, archive: Path, scratch: Path, box: PhotoBox | None, tick: Tick) -> pb.Inspection:
        """Read the capture without reconstructing it. Raises EdgeError when it cannot be used.

        box   rectangle of a photo that the object lies in; None: it is looked for
        tick  called often; raises Cancelled, which is passed on, when nobody waits for the answer any more
        """
        ...

    def make_download(self, tenant: str, order: DownloadOrder, scratch: Path, tick: Tick) -> StoredDownload:
        """Convert a published asset of a tenant to another format, and write the file to the store.

        scratch  empty folder for temporary files
        tick     called often; raises Cancelled, which is passed on, when this worker shuts down
        Raises EdgeError where the asset cannot be converted.
        """
        ...


class JobRun:
    """A job that this worker has taken. Its archive lies in `folder`, which is removed when the run's thread ends."""

    def __init__(
        self, request: ReconstructionRequest, archive: Path, folder: Path, checkpoints: CheckpointFiles
    ) -> None:
        self.request = request
        self.folder = folder
        self.log = EventLog(request.job)
        self._archive = archive
        self._checkpoints = checkpoints
        self._stop_with: pb.Failure | None = None
        self._last: tuple[pb.Progress, float] | None = None

    def start(self, work: Work, on_end: Callable[[Ending], None], cleanup: Callable[[], None]) -> None:
        """Run `work` on a new thread; at its end call `cleanup` on the thread, then `on_end` on the event loop.

        It is a daemon thread: one that is deep in native code must not keep the process alive when the worker stops.
        """
        loop = asyncio.get_running_loop()
        self.log.start_clock()

        def compute() -> None:
            ending: Ending = internal(self.request.job)
            try:
                ending = self._run(work, loop)
                self.release_checkpoint(ending)
            except BaseException:  # noqa: BLE001 - a run without an ending would hold its slot for ever
                _log.exception("job %s: its thread failed", self.request.job)
            finally:
                cleanup()
                _post(loop, on_end, ending)

        threading.Thread(target=compute, name=f"job {self.request.job}", daemon=True).start()

    def stop(self, failure: pb.Failure) -> None:
        """Ask the work to stop at its next report, and end with `failure`; of several calls the first one counts."""
        self._stop_with = self._stop_with or failure

    @property
    def is_resumable(self) -> bool:
        """Whether it is fitting, and another run of the job could go on from its checkpoint."""
        request = self.request
        return self.log.stage == pb.FITTING and self._checkpoints.exists(request.job, request.fence)

    def release_checkpoint(self, ending: Ending) -> None:
        """Remove the checkpoint at the run's end, unless the job will run again and resume from it."""
        if not _is_retried(ending):
            self._checkpoints.drop(self.request.job, self.request.fence)

    def _run(self, work: Work, loop: asyncio.AbstractEventLoop) -> Ending:
        """Do the work on the run's thread; every exception becomes a `Failure`."""
        scratch = self.folder / "work"
        try:
            scratch.mkdir()
            checkpoint = self._checkpoints.take(self.request.job, self.request.fence)
            request = self.request
            with (
                log_fields(job=request.job, tenant=request.tenant),
                capture_span("reconstruct", request.capture, job=request.job, preset=request.options.preset),
                stage_spans() as stages,
            ):
                return work.reconstruct(
                    self._archive, request, scratch, checkpoint, lambda update: self._report(loop, stages, update)
                )
        except Cancelled as cancelled:
            return self._stop_with or failure_of(cancelled, job=self.request.job, scratch=scratch)
        except BaseException as error:  # noqa: BLE001 - whatever ends this thread, the caller must get an ending
            return failure_of(error, job=self.request.job, scratch=scratch)

    def _report(self, loop: asyncio.AbstractEventLoop, stages: StageSpans, update: Update) -> None:
        """Post an update to the event loop, from the run's thread. Raises Cancelled or JobReturned after a stop.

        What has been published is told even then: the version is there.
        """
        if isinstance(update, pb.Published):
            _post(loop, self._record, update)
        if self._stop_with is not None:
            raise JobReturned if _is_retried(self._stop_with) else Cancelled
        if isinstance(update, pb.Progress):
            if update.stage:
                stages.enter(pb.Stage.Name(update.stage))
            if self._is_redundant(update):
                return
        if not isinstance(update, pb.Published):
            _post(loop, self._record, update)

    def _record(self, update: Update) -> None:
        # A run that was given up has its ending already, but its thread may still report once.
        if self.log.ending is None:
            self.log.add(update)

    def _is_redundant(self, progress: pb.Progress) -> bool:
        """Return whether to skip a progress report: it says nothing, repeats the last one, or follows it too soon."""
        if progress == pb.Progress():
            return True
        now = time.monotonic()
        if self._last is not None:
            last, reported_at = self._last
            if progress == last or (progress.stage == last.stage and now - reported_at < PROGRESS_APART_S):
                return True
        self._last = (progress, now)
        return False


def _is_retried(ending: Ending) -> bool:
    """Whether a gateway will send the job again, to resume from its checkpoint."""
    return isinstance(ending, pb.Failure) and ending.retryable


def _post(loop: asyncio.AbstractEventLoop, call: Callable[[Any], None], argument: Update | Ending) -> None:
    """Call a function on the event loop from a run's thread; the order of calls is kept.

    A closed loop means that the worker has shut down without waiting for this thread.
    """
    with suppress(RuntimeError):
        loop.call_soon_threadsafe(call, argument)
