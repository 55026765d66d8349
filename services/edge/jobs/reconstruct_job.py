"""Reconstruct a job's capture: a process makes the points and fits the field, or the central worker fits it."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.arrays import Tick
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.jobs.central_client import Central, CentralUnavailable
from capture2vr.edge.jobs.fit_job import FieldFitter
from capture2vr.edge.jobs.forward_job import forward, resume
from capture2vr.edge.jobs.inspect_capture import Inspector
from capture2vr.edge.jobs.job_process import JobProcess, JobProcesses
from capture2vr.edge.jobs.job_task import JobTask
from capture2vr.edge.jobs.make_download import make_download
from capture2vr.edge.preset import AUTOMATIC
from capture2vr.edge.worker.capabilities import Capabilities
from capture2vr.edge.worker.job_request import ReconstructionRequest
from capture2vr.edge.worker.job_run import Report
from capture2vr.order.option_table import GENERATE
from capture2vr.order.photo_box import PhotoBox
from capture2vr.sentences.sentence import say
from capture2vr.storage.catalogue.downloads import DownloadOrder, StoredDownload
from capture2vr.storage.catalogue.entry import DEFAULT_COLLECTION
from capture2vr.storage.tenant_store import store_of_tenant

_log = logging.getLogger(__name__)


class Reconstructor:
    """The worker's `Work`: each job has a process, the results of which the fitter publishes, or central's.

    central     fits the field to the points that this worker makes; where it is unavailable, the field is fitted here
    collection  lists the assets whose job names none, wherever they are fitted
    processes   starts those of the jobs
    """

    def __init__(
        self,
        fitter: FieldFitter,
        central: Central | None = None,
        collection: str = DEFAULT_COLLECTION,
        processes: JobProcesses | None = None,
    ) -> None:
        self._fitter = fitter
        self._own_offer = fitter.offer
        self._central = central
        self._collection = collection
        self._inspector = Inspector(models=fitter.machine.models)
        self._processes = processes or JobProcesses()

    def warm_up(self) -> None:
        """Start the servers of the inspections and the jobs now, so that the first phone need not wait for them."""
        self._inspector.start()
        self._processes.start()

    @property
    def offer(self) -> Capabilities:
        """This worker's own presets, with those of its central."""
        if (central := self._central) is None:
            return self._own_offer
        return self._own_offer.with_central(central.address, central.presets, takes_jobs=central.takes_jobs)

    def reconstruct(
        self, archive: Path, request: ReconstructionRequest, scratch: Path, checkpoint: Path, report: Report
    ) -> pb.Finished:
        """Run the whole job. Raises EdgeError, and Cancelled when `report` does.

        With a central worker, the points are made here, unless they were saved, and the field is fitted there; here
        where that is unavailable. A run of the job that central still has from an earlier lease is followed instead.
        """
        options = request.options
        request = replace(request, options=replace(options, collection=options.collection or self._collection))
        # Prepared points are fitted here: none is forwarded twice. What a generator made takes no training.
        central = None if request.prepared or request.options.preset == GENERATE else self._central
        if central and (finished := resume(central, request, report)) is not None:
            return finished
        task = self._task(archive, request, scratch, checkpoint, saves=central is not None)
        with self._processes.running(task, report) as process:
            if central:
                return self._fitted_with(central, process, request, report)
            return self._fitter.publish_all(process, request, report)

    def _fitted_with(
        self, central: Central, process: JobProcess, request: ReconstructionRequest, report: Report
    ) -> pb.Finished:
        """Have the points of a process fitted at central, or by the process where central is unavailable."""
        saved = process.saved()
        try:
            return _with_seconds(forward(central, saved.path, request, saved.reached, report), saved.seconds)
        except CentralUnavailable as unavailable:
            _log.warning("job %s: %s", request.job, unavailable)
            if not self._own_offer.has(request.options.preset):
                raise _unavailable(unavailable, request.options.preset) from None
            process.go_on(warning=say("field_fitted_on_worker", unavailable=unavailable))
            return self._fitter.publish_all(process, request, report)

    def inspect(self, archive: Path, scratch: Path, box: PhotoBox | None, tick: Tick) -> pb.Inspection:
        """Read a capture and return its kind, format and size, and the outline of the thing in a single photo.

        Raises EdgeError when reading it costs too much or crashes; other faults are the answer's `failure`.
        """
        return self._inspector.inspect(archive, scratch, box, tick)

    def make_download(self, tenant: str, order: DownloadOrder, scratch: Path, tick: Tick) -> StoredDownload:
        """Convert a published asset to another format. Raises EdgeError DOWNLOAD_* and STORE_UNAVAILABLE."""
        return make_download(store_of_tenant(self._fitter.store, tenant), order, scratch, tick)

    def _task(
        self, archive: Path, request: ReconstructionRequest, scratch: Path, checkpoint: Path, *, saves: bool
    ) -> JobTask:
        """What the job's process is told."""
        name = request.options.preset
        return JobTask(
            job=request.job,
            tenant=request.tenant,
            archive=archive.resolve(),
            most_seconds=request.most_seconds,
            scratch=scratch.resolve(),
            checkpoint=checkpoint.resolve(),
            options=request.options,
            preset=self._fitter.presets.get(name),
            machine=self._fitter.machine,
            trains=self.offer.trains(name),
            prepared=request.prepared,
            saves=saves,
            whole=self._may_tile(name),
            log_level=_log.getEffectiveLevel(),
        )

    def _may_tile(self, preset: str) -> bool:
        """Return whether a preset may make tiles, for which the central worker needs all points of a large scene."""
        known = self._fitter.presets.get(preset)
        return known is None or known.tiled or preset == AUTOMATIC


def _with_seconds(finished: pb.Finished, seconds: Mapping[str, float]) -> pb.Finished:
    """Add the seconds that stages took here."""
    for stage, more in seconds.items():
        finished.seconds[stage] += more
    return finished


def _unavailable(unavailable: CentralUnavailable, preset: str) -> EdgeError:
    message = say("central_unavailable_and_preset_not_here", unavailable=str(unavailable), preset=preset)
    return EdgeError("CENTRAL_UNAVAILABLE", message, hints=(say("try_again_later"),), retryable=True)
