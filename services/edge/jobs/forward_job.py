"""A job that another worker goes on with: the points go up, its events come back and are said in this worker's name."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import grpc

from services.edge.api import edge_pb2 as pb
from services.edge.central import Central, CentralAway
from services.edge.errors import Cancelled, EdgeError
from services.edge.requests import JobRequest
from services.edge.run import HandedBack, Say
from services.edge.streams import Broken, Stream, Upload

_log = logging.getLogger(__name__)

_FIRST_LOOK_S = 0.1  # before looking for a lost run: a worker that restarts needs a second or two
_LAST_LOOK_S = 2.0

_REFUSALS = {
    grpc.StatusCode.RESOURCE_EXHAUSTED,
    grpc.StatusCode.INVALID_ARGUMENT,
    grpc.StatusCode.DATA_LOSS,
    grpc.StatusCode.DEADLINE_EXCEEDED,
    grpc.StatusCode.ABORTED,
}
_UNKNOWN = {grpc.StatusCode.NOT_FOUND, grpc.StatusCode.OUT_OF_RANGE}


def hand_over(central: Central, archive: Path, request: JobRequest, begin: float, say: Say) -> pb.Finished:
    """Send prepared points, and say what `central` says from there on: its fractions on the bar's part from `begin`.

    Where it knows the job already, under an older lease say, that run is followed. Raises CentralAway as long as it has
    not taken the job, EdgeError for the failure that it reports and CENTRAL_LOST (retryable) where the connection does
    not come back, and Cancelled when `say` does.
    """
    central.require(request.preset)
    _log.info("job %s: its points go to central at %s", request.job, central.address)
    relay = _Relay(central, request, begin, say)
    with relay.cancelled_together():
        return relay.send(archive)


def take_up(central: Central, request: JobRequest, say: Say) -> pb.Finished | None:
    """Follow the job if an earlier lease of it still runs on `central`, else None. Raises as `hand_over`."""
    relay = _Relay(central, request, 0.0, say)
    try:
        if not central.runs(request.job):
            return None
        with relay.cancelled_together():
            return relay.find()
    except CentralAway:
        return None


class _Relay:
    """One job on its way through this worker, as far as it has been heard of."""

    def __init__(self, central: Central, request: JobRequest, begin: float, say: Say) -> None:
        self._central = central
        self._patience = central.patience
        self._request = request
        self._begin = begin
        self._say = say
        self._seq = 0
        self._last = pb.Progress(stage=pb.POINT_CLOUD, fraction=begin)

    def send(self, archive: Path) -> pb.Finished:
        """The job from its upload to its end."""
        size = archive.stat().st_size
        upload = Upload(_header(self._request, size), archive)
        self._tell(f"sending {size:,} bytes of points to central at {self._central.address}")
        stream = Stream(self._central.stub.Reconstruct(iter(upload)), upload)
        try:
            return self._follow(stream)
        except Broken as broken:
            known = broken.status == grpc.StatusCode.ALREADY_EXISTS
            if not known and (broken.status in _REFUSALS or not upload.through):
                raise CentralAway(f"central at {self._central.address} did not take the points ({broken})") from None
        return self.find()

    def find(self) -> pb.Finished:
        """The run from what was last heard of it to its end; where the stream breaks off, it is looked for again."""
        since, pause_s = time.monotonic(), _FIRST_LOOK_S
        while True:
            seq = self._seq
            try:
                return self._follow(Stream(self._attached()))
            except Broken as broken:
                if broken.status in _UNKNOWN:
                    raise self._forgotten() from None
                if self._seq > seq:
                    since, pause_s = time.monotonic(), _FIRST_LOOK_S
                elif time.monotonic() - since > self._patience.lost_s:
                    raise self._lost(f"was out of reach for {self._patience.lost_s:.0f} s") from None
                _log.warning("job %s: central at %s: %s", self._request.job, self._central.address, broken)
            self._wait(pause_s)
            pause_s = min(_LAST_LOOK_S, 1.5 * pause_s)

    def _attached(self) -> Any:
        return self._central.stub.Attach(pb.AttachRequest(job=self._request.job, after_seq=self._seq))

    def _follow(self, stream: Stream) -> pb.Finished:
        """Say what a stream says, to the end. Raises Broken where it ends before the run."""
        with closing(stream):
            while True:
                event = stream.next(self._patience.look_s)
                if event is None:
                    self._require_alive(stream)
                elif (finished := self._heard(event)) is not None:
                    return finished

    def _require_alive(self, stream: Stream) -> None:
        limit_s = self._patience.silence_s if stream.admitted else self._patience.admit_s
        if stream.silent_s() > limit_s:
            raise Broken(None, f"not a word for {limit_s:g} s")
        self._say(self._last)  # which tells whether the job is still wanted

    def _heard(self, event: pb.Event) -> pb.Finished | None:
        self._seq = event.seq
        match event.WhichOneof("what"):
            case "progress":
                self._last = self._placed(event.progress)
                self._say(self._last)
            case "published":
                self._say(event.published)
            case "failure":
                raise _failure(event.failure)
            case "finished":
                return event.finished
            case _:  # a heartbeat, or something that a newer worker says
                self._say(self._last)
        return None

    def _placed(self, told: pb.Progress) -> pb.Progress:
        """Central's progress on this worker's bar. Until it fits, its reading and its queue are part of the points."""
        return pb.Progress(
            stage=max(told.stage, pb.POINT_CLOUD),
            fraction=self._begin + (1.0 - self._begin) * told.fraction,
            losses=told.losses,
            eta_s=told.eta_s,
            message=told.message,
        )

    def _tell(self, message: str) -> None:
        self._say(pb.Progress(stage=self._last.stage, fraction=self._last.fraction, message=message))

    def _wait(self, seconds: float) -> None:
        """Before the next look for a lost run, as long as the job is wanted."""
        until = time.monotonic() + seconds
        while (left_s := until - time.monotonic()) > 0:
            self._tell(f"looking for the connection to central at {self._central.address}")
            time.sleep(min(left_s, self._patience.look_s))

    @contextmanager
    def cancelled_together(self) -> Iterator[None]:
        """A cancellation goes on to central. One that only hands the job back leaves it there for its next lease."""
        try:
            yield
        except HandedBack:
            raise
        except Cancelled:
            self._cancel()
            raise

    def _cancel(self) -> None:
        """Nobody waits for this, and a central that is away hears of it once it is back."""
        job = self._request.job
        call = self._central.stub.Cancel.future(
            pb.CancelRequest(job=job), timeout=self._patience.cancel_s, wait_for_ready=True
        )
        # The callback also keeps the call, which would end with its last reference.
        call.add_done_callback(lambda done: _log.info("job %s: cancelled at central: %s", job, done.code()))

    def _forgotten(self) -> Exception:
        if self._seq == 0:
            return CentralAway(f"central at {self._central.address} does not have the points that it was sent")
        return self._lost("no longer knows it; it was restarted, perhaps")

    def _lost(self, why: str) -> EdgeError:
        message = f"central at {self._central.address}, which had taken the job, {why}"
        return EdgeError("CENTRAL_LOST", message, hints=("send the job again: its points are kept",), retryable=True)


def _header(request: JobRequest, size: int) -> pb.Header:
    """The job as it was asked for; what was done to the points is done, and said by `prepared`."""
    return pb.Header(
        job=request.job,
        fence=request.fence,
        preset=request.preset,
        asset_key=request.asset_key,
        target=request.target,
        capture_bytes=size,
        label=request.label,
        prepared=True,
        collection=request.collection,
    )


def _failure(told: pb.Failure) -> EdgeError:
    return EdgeError(told.code, told.message, file=told.file or None, hints=tuple(told.hints), retryable=told.retryable)
