"""The worker that fits for this one: what it says of itself, and whether a job can be handed over to it."""

from __future__ import annotations

import logging
import threading
from dataclasses import dataclass
from typing import Any

import grpc

from services.edge.api import edge_pb2 as pb
from services.edge.api import edge_pb2_grpc
from services.edge.prepared import VERSION
from services.link import PLAIN, Caller

_log = logging.getLogger(__name__)

_OPTIONS = (
    ("grpc.max_receive_message_length", 8 << 20),
    ("grpc.max_send_message_length", 8 << 20),
    ("grpc.keepalive_time_ms", 20_000),
    ("grpc.keepalive_timeout_ms", 10_000),
    # A worker that restarts is back within seconds; gRPC's own pauses grow to two minutes.
    ("grpc.initial_reconnect_backoff_ms", 200),
    ("grpc.min_reconnect_backoff_ms", 500),
    ("grpc.max_reconnect_backoff_ms", 1_000),
)


@dataclass(frozen=True, slots=True)
class Patience:
    """Seconds to wait for the central worker.

    answer_s   for its state: a person's job waits behind this, and it may be restarting
    admit_s    for its word on a header, before any points are sent
    silence_s  without a word, three heartbeats missed: the stream is dead
    lost_s     for the connection to a job that it has taken
    cancel_s   for a cancellation to reach it, while nobody waits for that
    look_s     between two looks at whether the job is still wanted, which must be heard within two seconds
    refresh_s  between two questions about what it offers
    """

    answer_s: float = 1.0
    admit_s: float = 10.0
    silence_s: float = 15.0
    lost_s: float = 60.0
    cancel_s: float = 60.0
    look_s: float = 0.2
    refresh_s: float = 5.0


class CentralAway(Exception):  # noqa: N818 - it reads as what it is
    """The central worker does not take the job; the sentence says why. Nothing of the job runs there."""


class Central:
    """The worker at `address`, asked now and then what it offers. Used from the threads of the jobs."""

    def __init__(self, address: str, patience: Patience | None = None, caller: Caller = PLAIN) -> None:
        self.address = address
        self.patience = patience or Patience()
        self._channel = caller.channel(address, _OPTIONS)
        self.stub: Any = edge_pb2_grpc.EdgeReconstructionStub(self._channel)  # type: ignore[no-untyped-call]
        self._closed = threading.Event()
        self._presets: tuple[pb.Preset, ...] = ()
        self._fault: str | None = None
        threading.Thread(target=self._watch, name=f"central {address}", daemon=True).start()

    @property
    def presets(self) -> tuple[pb.Preset, ...]:
        """What it offered when it last answered; nothing before it first did."""
        return self._presets

    @property
    def takes_jobs(self) -> bool:
        """Whether it did when it was last asked."""
        return self._fault == ""

    def worker(self) -> pb.Worker:
        """What it says of itself now. Raises CentralAway where it does not answer."""
        try:
            # Ready or not: a channel that has just failed would else fail for another second without looking.
            answer: pb.Worker = self.stub.GetWorker(
                pb.GetWorkerRequest(), timeout=self.patience.answer_s, wait_for_ready=True
            )
        except grpc.RpcError as error:
            raise CentralAway(f"central at {self.address} {_silence(error)}") from None
        return answer

    def require(self, preset: str) -> None:
        """Raise CentralAway unless it would take a job of this preset now."""
        worker = self.worker()
        if fault := _fault(worker):
            raise CentralAway(f"central at {self.address} {fault}")
        if preset not in {each.name for each in worker.presets}:
            raise CentralAway(f"central at {self.address} does not offer preset {preset}")

    def runs(self, job: str) -> bool:
        """Whether it has a run of the job that has not ended. Raises CentralAway where it does not answer."""
        worker = self.worker()
        return not worker.central and job in worker.jobs  # one that is its own central has the very job that asks

    def close(self) -> None:
        """Ask no more; open streams end."""
        self._closed.set()
        self._channel.close()

    def _watch(self) -> None:
        while not self._closed.is_set():
            self._look()
            self._closed.wait(self.patience.refresh_s)

    def _look(self) -> None:
        before = self._fault
        try:
            worker = self.worker()
            self._presets, self._fault = tuple(worker.presets), _fault(worker)
        except CentralAway as away:
            self._fault = str(away).removeprefix(f"central at {self.address} ")
        except ValueError:  # the channel was closed just now
            return
        if not self._closed.is_set() and self._fault != before:
            told = self._fault or f"fits for this worker, on {worker.device}"
            _log.log(logging.WARNING if self._fault else logging.INFO, "central at %s %s", self.address, told)


def _silence(error: grpc.RpcError) -> str:
    """Why a worker gave no answer, where a person can do something about it."""
    refused = isinstance(error, grpc.Call) and error.code() == grpc.StatusCode.UNAUTHENTICATED
    return "refuses this worker's EDGE_CENTRAL_TOKEN" if refused else "could not be reached"


def _fault(worker: pb.Worker) -> str:
    """Why a worker cannot be anybody's central; "" where it can."""
    if worker.central:
        # Two workers that wait for each other's slots would wait for ever, and one that is its own central too.
        return f"has a central itself, {worker.central}"
    if worker.points_version != VERSION:
        return f"takes points of version {worker.points_version}, not {VERSION}: give both the same capture2vr"
    return "is shutting down" if worker.draining else ""
