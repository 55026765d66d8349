"""Client of the central worker, which fits fields for this one: its presets, and the events of forwarded jobs.

Jobs run on threads of their own; the gRPC calls run on one event loop in another thread.
"""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import AsyncGenerator, Callable, Coroutine
from concurrent.futures import CancelledError, Future
from contextlib import aclosing, suppress
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import TypeVar

import grpc

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.api.grpc_client import GrpcClient, StreamEnded
from capture2vr.edge.worker.capabilities import POINTS_VERSION
from capture2vr.process.grpc_security import NO_CREDENTIALS, ClientCredentials
from capture2vr.sentences.sentence import say

_log = logging.getLogger(__name__)

Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class Timeouts:
    """Timeouts and intervals of calls to the central worker, in seconds.

    answer_s   to get its state: a person's job waits for this, and it may be restarting
    admit_s    to get its answer to a header, before any points are sent
    silence_s  without a message, after which a stream counts as dead: three heartbeats were missed
    lost_s     to reconnect to a job that it has taken
    cancel_s   to deliver a cancellation, which nobody waits for
    look_s     between two checks for a cancellation, which must take effect within two seconds
    refresh_s  between two requests for its state and presets
    """

    answer_s: float = 1.0
    admit_s: float = 10.0
    silence_s: float = 15.0
    lost_s: float = 60.0
    cancel_s: float = 60.0
    look_s: float = 0.2
    refresh_s: float = 5.0


class CentralUnavailable(Exception):  # noqa: N818 - not always an error: the job is then fitted here
    """The central worker does not take the job; the message says why. Nothing of the job runs there."""


class EventStream:
    """Queue of a call's events, from the event loop to a job's thread, which can do other things between two events."""

    def __init__(self, events: AsyncGenerator[pb.Event, None], loop: asyncio.AbstractEventLoop) -> None:
        self._queue: SimpleQueue[pb.Event | Exception] = SimpleQueue()
        self._reading = asyncio.run_coroutine_threadsafe(self._read(events), loop)

    def next(self, within_s: float) -> pb.Event | None:
        """Wait for the next event; None where none came in time. Raises StreamEnded and OSError as the call did."""
        try:
            event = self._queue.get(timeout=within_s)
        except Empty:
            return None
        if isinstance(event, Exception):
            raise event
        return event

    def close(self) -> None:
        """Cancel the call."""
        self._reading.cancel()

    async def _read(self, events: AsyncGenerator[pb.Event, None]) -> None:
        try:
            async with aclosing(events):
                async for event in events:
                    self._queue.put(event)
            self._queue.put(StreamEnded(None, "the stream ended before the run did"))
        except asyncio.CancelledError:
            self._queue.put(StreamEnded(None, "the connection was closed"))
            raise
        except Exception as error:  # noqa: BLE001 - whatever ended the call must reach the job's thread
            self._queue.put(error)


class Central:
    """The central worker at `address`; its state is polled in the background. Used from the threads of the jobs."""

    def __init__(
        self, address: str, timeouts: Timeouts | None = None, credentials: ClientCredentials = NO_CREDENTIALS
    ) -> None:
        self.address = address
        self.timeouts = timeouts or Timeouts()
        self._presets: tuple[pb.Preset, ...] = ()
        self._fault: str | None = None
        self._loop = asyncio.new_event_loop()
        self._closing = asyncio.Event()
        self._client: Future[GrpcClient] = Future()
        self._thread = threading.Thread(
            target=self._run_loop, args=(credentials,), name=f"central {address}", daemon=True
        )
        self._thread.start()
        self._client.result()  # raises what kept the client from being made

    @property
    def presets(self) -> tuple[pb.Preset, ...]:
        """Presets that it offered when it last answered; none before its first answer."""
        return self._presets

    @property
    def takes_jobs(self) -> bool:
        """Whether it could take jobs when its state was last polled."""
        return self._fault == ""

    def worker(self) -> pb.Worker:
        """Get its state now. Raises CentralUnavailable where it does not answer."""
        try:
            return self._start(self._get_worker()).result()
        except CancelledError:  # closed meanwhile
            raise CentralUnavailable(f"the connection to central at {self.address} was closed") from None

    def require(self, preset: str) -> None:
        """Raise CentralUnavailable unless it would take a job with this preset now."""
        worker = self.worker()
        if fault := _fault(worker):
            raise CentralUnavailable(say("central_fault", address=self.address, fault=fault))
        if preset not in {each.name for each in worker.presets}:
            raise CentralUnavailable(f"central at {self.address} does not offer preset {preset}")

    def has_run(self, job: str) -> bool:
        """Whether it has a run of the job that has not ended. Raises CentralUnavailable where it does not answer."""
        worker = self.worker()
        return not worker.central and job in worker.jobs  # a worker that is its own central lists this very run

    def stream(self, call: Callable[[GrpcClient], AsyncGenerator[pb.Event, None]]) -> EventStream:
        """Start a call of the client; return the stream of its events, which the caller closes."""
        return EventStream(call(self._client.result()), self._loop)

    def cancel(self, job: str, token: str) -> None:
        """Cancel a run there without waiting: a central that cannot be reached gets it later, within `cancel_s`."""
        with suppress(CentralUnavailable):
            self._start(self._cancel(job, token))

    def close(self) -> None:
        """Stop polling and close the connection; open streams end."""
        self._loop.call_soon_threadsafe(self._closing.set)
        self._thread.join()

    def _start(self, coroutine: Coroutine[None, None, Result]) -> Future[Result]:
        """Start a coroutine on the event loop. Raises CentralUnavailable once the connection is closed."""
        try:
            return asyncio.run_coroutine_threadsafe(coroutine, self._loop)
        except RuntimeError:
            coroutine.close()
            raise CentralUnavailable(f"the connection to central at {self.address} was closed") from None

    def _run_loop(self, credentials: ClientCredentials) -> None:
        """Run the event loop until `close`; the runner then cancels the tasks that are left, and closes the loop."""
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            runner.run(self._poll_until_closed(credentials))

    async def _poll_until_closed(self, credentials: ClientCredentials) -> None:
        """Create the client here on the event loop, because a channel belongs to the loop that it is created on."""
        try:
            client = GrpcClient(self.address, credentials, silence_s=self.timeouts.silence_s)
        except Exception as error:  # noqa: BLE001 - passed on to the thread that waits for the client
            self._client.set_exception(error)
            return
        self._client.set_result(client)
        polling = asyncio.create_task(self._poll())
        await self._closing.wait()
        polling.cancel()
        await client.close()

    async def _cancel(self, job: str, token: str) -> None:
        try:
            await self._client.result().cancel(job, token, self.timeouts.cancel_s, wait_for_ready=True)
            _log.info("job %s: cancelled at central", job)
        except grpc.aio.AioRpcError as error:
            _log.warning("job %s: not cancelled at central: %s", job, error.details())

    async def _get_worker(self) -> pb.Worker:
        try:
            return await self._client.result().worker(self.timeouts.answer_s, wait_for_ready=True)
        except grpc.aio.AioRpcError as error:
            raise CentralUnavailable(
                say("central_fault", address=self.address, fault=_call_fault(error.code()))
            ) from None

    async def _poll(self) -> None:
        while True:
            await self._refresh()
            await asyncio.sleep(self.timeouts.refresh_s)

    async def _refresh(self) -> None:
        """Update presets and state; log when the state has changed."""
        before = self._fault
        try:
            worker = await self._get_worker()
            self._presets, self._fault = tuple(worker.presets), _fault(worker)
        except CentralUnavailable as unavailable:
            self._fault = str(unavailable).removeprefix(f"central at {self.address} ")
        if self._fault != before:
            state = self._fault or f"fits fields for this worker, on {worker.device}"
            _log.log(logging.WARNING if self._fault else logging.INFO, "central at %s %s", self.address, state)


def _call_fault(status: grpc.StatusCode) -> str:
    """Why a call failed, in words after "central at host:port"; a wrong token is named, for it can be corrected."""
    refused = status is grpc.StatusCode.UNAUTHENTICATED
    return "refuses this worker's EDGE_CENTRAL_TOKEN" if refused else say("could_not_be_reached")


def _fault(worker: pb.Worker) -> str:
    """Why a worker cannot be used as central, in words after "central at host:port"; "" where it can."""
    if worker.central:
        # Two workers that wait for each other's slots would deadlock; so would one that is its own central.
        return f"has a central itself, {worker.central}"
    if worker.points_version != POINTS_VERSION:
        theirs = f"takes points of version {worker.points_version}, not {POINTS_VERSION}"
        return f"{theirs}: install the same capture2vr on both"
    return "is shutting down" if worker.draining else ""
