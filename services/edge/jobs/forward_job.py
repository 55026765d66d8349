"""Forward a job to the central worker: send it the points, and pass its events on as this worker's own."""

from __future__ import annotations

import logging
import threading
from collections.abc import AsyncGenerator, Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import grpc

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.api.grpc_client import RUN_UNKNOWN, GrpcClient, StreamEnded, file_chunks
from capture2vr.edge.api.header_options import header_fields
from capture2vr.edge.errors import Cancelled, EdgeError
from capture2vr.edge.jobs.central_client import Central, CentralUnavailable
from capture2vr.edge.worker.coded_messages import coded_progress
from capture2vr.edge.worker.failures import error_of
from capture2vr.edge.worker.job_request import ReconstructionRequest
from capture2vr.edge.worker.job_run import JobReturned, Report
from capture2vr.sentences.sentence import say

_log = logging.getLogger(__name__)

# Statuses with which central has refused the job for certain, even where the whole archive was sent.
_REFUSALS = {
    grpc.StatusCode.RESOURCE_EXHAUSTED,
    grpc.StatusCode.INVALID_ARGUMENT,
    grpc.StatusCode.DATA_LOSS,
    grpc.StatusCode.DEADLINE_EXCEEDED,
    grpc.StatusCode.ABORTED,
}


def forward(
    central: Central, archive: Path, request: ReconstructionRequest, begin: float, report: Report
) -> pb.Finished:
    """Send prepared points to `central`, and report its events until the job ends.

    begin  fraction of this worker's progress at which central's begins

    Where central knows the job already, for example from an older lease, that run is followed. Raises
    CentralUnavailable as long as it has not taken the job, EdgeError for the failure that it reports and CENTRAL_LOST
    (retryable) where the connection does not come back, and Cancelled when `report` does.
    """
    central.require(request.options.preset)
    _log.info("job %s: sending its points to central at %s", request.job, central.address)
    forwarding = _Forwarding(central, request, begin, report)
    with forwarding.cancelling_central():
        return forwarding.send(archive)


def resume(central: Central, request: ReconstructionRequest, report: Report) -> pb.Finished | None:
    """Follow the job's run on `central` to its end if an earlier lease started one there; else None.

    Raises as `forward`.
    """
    forwarding = _Forwarding(central, request, 0.0, report)
    try:
        if not central.has_run(request.job):
            return None
        with forwarding.cancelling_central():
            return forwarding.follow_run()
    except CentralUnavailable:
        return None


class _Forwarding:
    """One forwarded job: the number of the last event received, and the last progress."""

    def __init__(self, central: Central, request: ReconstructionRequest, begin: float, report: Report) -> None:
        self._central = central
        self._timeouts = central.timeouts
        self._reconnecting = threading.Event()  # set while the connection is lost
        self._request = request
        self._begin = begin
        self._report = report
        self._seq = 0
        self._last = pb.Progress(stage=pb.POINT_CLOUD, fraction=begin)

    def send(self, archive: Path) -> pb.Finished:
        """Upload the points, and follow the job to its end."""
        size = archive.stat().st_size
        header = _header(self._request, size)
        self._report_message(say("sending_bytes_points_to_central", size=size, address=self._central.address))
        admit_s = self._timeouts.admit_s
        try:
            return self._follow(lambda client: client.reconstruct(header, file_chunks(archive), admit_s=admit_s))
        except StreamEnded as ended:
            # Whoever has told of the job has taken it, even where the call then reached its deadline, say.
            known = ended.status == grpc.StatusCode.ALREADY_EXISTS or self._seq > 0
            if not known and (ended.status in _REFUSALS or not ended.delivered):
                fault = f"did not take the points ({ended})"
                raise CentralUnavailable(say("central_fault", address=self._central.address, fault=fault)) from None
        return self.follow_run()

    def follow_run(self) -> pb.Finished:
        """Follow the run from the last event received to its end; reconnect where the stream breaks."""
        job, token = self._request.job, self._request.token
        seq, give_up_s = self._seq, self._timeouts.lost_s
        lost = self._reconnecting.set
        try:
            return self._follow(lambda client: client.follow(job, token, seq, give_up_s=give_up_s, lost=lost))
        except StreamEnded as ended:
            if ended.status in RUN_UNKNOWN:
                raise self._run_unknown() from None
            raise self._lost(say("could_not_be_reached_s", seconds=give_up_s)) from None

    def _follow(self, call: Callable[[GrpcClient], AsyncGenerator[pb.Event, None]]) -> pb.Finished:
        """Report the events of a call, to the run's end. Raises StreamEnded where the call ends before the run."""
        with closing(self._central.stream(call)) as stream:
            while True:
                event = stream.next(self._timeouts.look_s)
                if event is None:
                    self._check_cancelled()
                elif (finished := self._handle(event)) is not None:
                    return finished

    def _check_cancelled(self) -> None:
        """Repeat the last report: it raises Cancelled if the job was cancelled."""
        if self._reconnecting.is_set():
            self._report_message(say("reconnecting_to_central", address=self._central.address))
        else:
            self._report(self._last)

    def _handle(self, event: pb.Event) -> pb.Finished | None:
        """Report one of central's events; return the last. Raises EdgeError for a failure."""
        self._seq = event.seq
        self._reconnecting.clear()
        match event.WhichOneof("what"):
            case "progress":
                self._last = self._to_own_progress(event.progress)
                self._report(self._last)
            case "published":
                self._report(event.published)
            case "failure":
                raise error_of(event.failure)
            case "finished":
                return event.finished
            case _:  # a heartbeat, or an event that only a newer version knows
                self._report(self._last)
        return None

    def _to_own_progress(self, progress: pb.Progress) -> pb.Progress:
        """Map central's progress to this worker's. Its reading and queueing are reported as the stage POINT_CLOUD."""
        return pb.Progress(
            stage=max(progress.stage, pb.POINT_CLOUD),
            fraction=self._begin + (1.0 - self._begin) * progress.fraction,
            losses=progress.losses,
            eta_s=progress.eta_s,
            message=progress.message,
            i18n=progress.i18n,
        )

    def _report_message(self, message: str) -> None:
        self._report(coded_progress(message, stage=self._last.stage, fraction=self._last.fraction))

    @contextmanager
    def cancelling_central(self) -> Iterator[None]:
        """Cancel the run at central too when the job is cancelled in the block.

        Where this worker only returns the job (JobReturned), the run goes on there for the job's next lease.
        """
        try:
            yield
        except JobReturned:
            raise
        except Cancelled:
            self._central.cancel(self._request.job, self._request.token)
            raise

    def _run_unknown(self) -> Exception:
        """The error for a central that does not know the run: it never had the job, or lost it after an event."""
        if self._seq == 0:
            return CentralUnavailable(f"central at {self._central.address} does not have the points that were sent")
        return self._lost(say("no_longer_knows_job_may"))

    def _lost(self, why: str) -> EdgeError:
        message = say("central_had_taken_job", address=self._central.address, why=why)
        return EdgeError("CENTRAL_LOST", message, hints=(say("send_job_again_points_kept"),), retryable=True)


def _header(request: ReconstructionRequest, size: int) -> pb.Header:
    """Header for central: the request, without the options that are in the points."""
    return pb.Header(
        job=request.job,
        fence=request.fence,
        asset_key=request.asset_key,
        capture_bytes=size,
        prepared=True,
        tenant=request.tenant,
        token=request.token,
        capture=request.capture,
        most_seconds=request.most_seconds,
        **header_fields(request.options.without_points()),
    )
