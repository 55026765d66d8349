"""Reconstruct a job's capture: unpack the archive, make the points, fit the field here or at the central worker."""

from __future__ import annotations

import logging
import time
from collections.abc import Generator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.arrays import Tick
from capture2vr.edge.asset.manifest import anchors_m, asset_frame
from capture2vr.edge.capture_to_points import PreparedPoints, prepare
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.field.device import own_stream
from capture2vr.edge.jobs.central_client import Central, CentralUnavailable
from capture2vr.edge.jobs.fit_job import FieldFitter, to_wire
from capture2vr.edge.jobs.forward_job import forward, resume
from capture2vr.edge.jobs.inspect_capture import Inspector, unpack_capture
from capture2vr.edge.jobs.make_download import make_download
from capture2vr.edge.jobs.points_archive import read_prepared
from capture2vr.edge.jobs.points_cache import load_points, save_points
from capture2vr.edge.points.nouns import Points
from capture2vr.edge.preset import AUTOMATIC
from capture2vr.edge.progress import Bar, Progress
from capture2vr.edge.read_capture import read_capture
from capture2vr.edge.worker.capabilities import Capabilities
from capture2vr.edge.worker.coded_messages import coded_progress
from capture2vr.edge.worker.job_request import ReconstructionRequest
from capture2vr.edge.worker.job_run import Report
from capture2vr.order.photo_box import PhotoBox
from capture2vr.sentences.sentence import say
from capture2vr.storage.catalogue.downloads import DownloadOrder, StoredDownload
from capture2vr.storage.catalogue.entry import DEFAULT_COLLECTION
from capture2vr.storage.tenant_store import store_of_tenant

T = TypeVar("T")

_log = logging.getLogger(__name__)


class Reconstructor:
    """The worker's `Work`: makes the points of a capture, and lets the fitter or central do the rest.

    central     fits the field to the points that this worker makes; where it is unavailable, the field is fitted here
    collection  lists the assets whose job names none, wherever they are fitted
    """

    def __init__(
        self, fitter: FieldFitter, central: Central | None = None, collection: str = DEFAULT_COLLECTION
    ) -> None:
        self._fitter = fitter
        self._own_offer = fitter.offer
        self._central = central
        self._collection = collection
        self._inspector = Inspector()

    def warm_up(self) -> None:
        """Start the server of the inspections now, so that the first phone need not wait for it."""
        self._inspector.start()

    @property
    def offer(self) -> Capabilities:
        """This worker's own presets, with those of its central."""
        if (central := self._central) is None:
            return self._own_offer
        return self._own_offer.with_central(central.address, central.presets, takes_jobs=central.takes_jobs)

    def reconstruct(
        self, archive: Path, request: ReconstructionRequest, scratch: Path, checkpoint: Path, report: Report
    ) -> pb.Finished:
        """Run the whole job. Raises EdgeError, and Cancelled when `report` does."""
        options = request.options
        request = replace(request, options=replace(options, collection=options.collection or self._collection))
        with own_stream(self._fitter.device.name):
            if self._central and not request.prepared:  # prepared points are fitted here: no job is forwarded twice
                return self._reconstruct_with(self._central, archive, request, scratch, checkpoint, report)
            bar = Bar(lambda progress: report(to_wire(progress)))
            prepared, seconds = self._prepare_points(archive, request, scratch, bar, report)
            return _with_validating(self._fitter.fit(prepared, bar, request, checkpoint, report), seconds)

    def inspect(self, archive: Path, scratch: Path, box: PhotoBox | None, tick: Tick) -> pb.Inspection:
        """Read a capture and return its kind, format and size, and the outline of the thing in a single photo.

        Raises EdgeError when reading it costs too much or crashes; other faults are the answer's `failure`.
        """
        return self._inspector.inspect(archive, scratch, box, tick)

    def make_download(self, tenant: str, order: DownloadOrder, scratch: Path, tick: Tick) -> StoredDownload:
        """Convert a published asset to another format. Raises EdgeError DOWNLOAD_* and STORE_UNAVAILABLE."""
        return make_download(store_of_tenant(self._fitter.store, tenant), order, scratch, tick)

    def _reconstruct_with(
        self,
        central: Central,
        archive: Path,
        request: ReconstructionRequest,
        scratch: Path,
        checkpoint: Path,
        report: Report,
    ) -> pb.Finished:
        """Make the points here, unless they were saved, and fit the field at central; here where that is unavailable.

        A run of the job that central still has from an earlier lease is followed instead.
        """
        if (finished := resume(central, request, report)) is not None:
            return finished
        bar = Bar(lambda progress: report(to_wire(progress)))
        seconds = 0.0
        if (prepared := load_points(checkpoint, scratch / "kept")) is None:
            prepared, seconds = self._prepare_points(archive, request, scratch, bar, report)
            if not self._may_tile(request.options.preset):
                prepared = replace(prepared, points=replace(prepared.points, whole=None))
        try:
            finished = forward(central, save_points(prepared, checkpoint), request, bar.reached, report)
        except CentralUnavailable as unavailable:
            _log.warning("job %s: %s", request.job, unavailable)
            if not self._own_offer.has(request.options.preset):
                raise _unavailable(unavailable, request.options.preset) from None
            prepared = _with_warning(prepared, say("field_fitted_on_worker", unavailable=unavailable))
            finished = self._fitter.fit(prepared, bar, request, checkpoint, report)
        return _with_validating(finished, seconds)

    def _may_tile(self, preset: str) -> bool:
        """Return whether a preset may make tiles, for which the central worker needs all points of a large scene."""
        known = self._fitter.presets.get(preset)
        return known is None or known.tiled or preset == AUTOMATIC

    def _prepare_points(
        self, archive: Path, request: ReconstructionRequest, scratch: Path, bar: Bar, report: Report
    ) -> tuple[PreparedPoints, float]:
        """Make or read the points of an archive; also return the seconds that reading the archive took."""
        what = say("word_points" if request.prepared else "word_capture")
        reading = coded_progress(say("reading", what=what), stage=pb.VALIDATING)
        report(reading)
        began = time.perf_counter()
        if request.prepared:
            return read_prepared(archive, scratch / "prepared"), time.perf_counter() - began
        capture = read_capture(unpack_capture(archive, scratch), tick=lambda fraction: report(reading))
        seconds = time.perf_counter() - began
        refines = self.offer.trains(request.options.preset)
        steps = prepare(capture, bar, request.options, refines=refines, device=self._fitter.device.name)
        prepared = _run_to_end(steps, report)
        report(_anchor_points(prepared.points))
        return prepared, seconds


def _anchor_points(points: Points) -> pb.AnchorPoints:
    """The points that are shown before there is a mesh, in the asset frame of the points alone."""
    xyz, rgb = anchors_m(points, asset_frame(points.xyz, points))
    return pb.AnchorPoints(xyz_m=xyz.ravel(), rgb=rgb.tobytes())


def _run_to_end(steps: Generator[Progress, None, T], report: Report) -> T:
    """Run a generator to its end: report the progress that it yields, return what it returns."""
    with closing(steps):
        while True:
            try:
                report(to_wire(next(steps)))
            except StopIteration as ended:
                result: T = ended.value
                return result


def _with_warning(prepared: PreparedPoints, warning: str) -> PreparedPoints:
    points = prepared.points
    return replace(prepared, points=replace(points, warnings=(*points.warnings, warning)))


def _with_validating(finished: pb.Finished, seconds: float) -> pb.Finished:
    """Add the seconds that reading the archive took to the stage VALIDATING."""
    finished.seconds["VALIDATING"] += seconds
    return finished


def _unavailable(unavailable: CentralUnavailable, preset: str) -> EdgeError:
    message = say("central_unavailable_and_preset_not_here", unavailable=str(unavailable), preset=preset)
    return EdgeError("CENTRAL_UNAVAILABLE", message, hints=(say("try_again_later"),), retryable=True)
