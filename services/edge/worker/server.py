"""The edge worker's gRPC server: statuses, health, drain. What it computes is handed in as `Work`."""

from __future__ import annotations

import asyncio
import json
import logging
import signal
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

import grpc
from grpc_health.v1 import health, health_pb2, health_pb2_grpc

from services import __version__
from services.edge.api import edge_pb2 as pb
from services.edge.api import edge_pb2_grpc
from services.edge.door import TokenDoor, heard_out
from services.edge.inspections import Inspections
from services.edge.requests import JobRequest, RefusedError
from services.edge.run import Work
from services.edge.runs import Runs
from services.edge.scratch import Scratch
from services.edge.settings import EdgeSettings, open_door
from services.edge.upload import first_header
from services.link import Door
from services.strict_settings import SettingsError

_log = logging.getLogger(__name__)

SERVICE = pb.DESCRIPTOR.services_by_name["EdgeReconstruction"].full_name

MESSAGE_BYTES = 8 << 20
"""Largest message either way: eight of the wire's largest chunks."""

OPTIONS = (
    ("grpc.max_receive_message_length", MESSAGE_BYTES),
    ("grpc.max_send_message_length", MESSAGE_BYTES),
    # A phone's hotspot drops silent connections after about 30 s: ping before, and notice a dead peer within 10 s.
    ("grpc.keepalive_time_ms", 20_000),
    ("grpc.keepalive_timeout_ms", 10_000),
    ("grpc.keepalive_permit_without_calls", 1),
    # Gateways may ping as often, without being sent away with ENHANCE_YOUR_CALM.
    ("grpc.http2.min_recv_ping_interval_without_data_ms", 5_000),
    # A second worker on the same port must fail, not silently take half the calls.
    ("grpc.so_reuseport", 0),
)

FAREWELL_S = 2.0
"""Seconds that open streams get to carry their terminal event once every job has ended."""

Context = grpc.aio.ServicerContext[Any, Any]


class EdgeServicer(edge_pb2_grpc.EdgeReconstructionServicer):
    """The wire's five calls on a worker's `Runs` and `Inspections`."""

    def __init__(self, settings: EdgeSettings, work: Work, runs: Runs, inspections: Inspections) -> None:
        self._settings = settings
        self._work = work
        self._runs = runs
        self._inspections = inspections

    async def Reconstruct(self, request_iterator: AsyncIterator[pb.Chunk], context: Context) -> AsyncIterator[pb.Event]:  # noqa: N802
        chunks = aiter(request_iterator)
        try:
            header = await first_header(chunks, limit_bytes=self._settings.max_capture_bytes)
            request = JobRequest.of(header, self._work.offer)
            run = await self._runs.take(request, _welcomed(chunks, context), header.capture_bytes)
        except RefusedError as refused:
            await _refuse(context, refused, chunks)
        async for event in run.log.follow():
            yield event

    async def Inspect(self, request_iterator: AsyncIterator[pb.Chunk], context: Context) -> pb.Inspection:  # noqa: N802
        chunks = aiter(request_iterator)
        try:
            header = await first_header(chunks, limit_bytes=self._settings.max_capture_bytes)
            return await self._inspections.inspect(_welcomed(chunks, context), header.capture_bytes)
        except RefusedError as refused:
            await _refuse(context, refused, chunks)

    async def Attach(self, request: pb.AttachRequest, context: Context) -> AsyncIterator[pb.Event]:  # noqa: N802
        run = self._runs.find(request.job)
        if run is None:
            await context.abort(grpc.StatusCode.NOT_FOUND, "JOB_UNKNOWN: this worker does not know the job")
        if request.after_seq > run.log.last_seq:
            said = f"this run has said {run.log.last_seq} events, not {request.after_seq}"
            await context.abort(grpc.StatusCode.OUT_OF_RANGE, f"SEQ_UNKNOWN: {said}")
        async for event in run.log.follow(request.after_seq):
            yield event

    async def Cancel(self, request: pb.CancelRequest, context: Context) -> pb.CancelReply:  # noqa: N802
        return pb.CancelReply(was_running=self._runs.cancel(request.job))

    async def GetWorker(self, request: pb.GetWorkerRequest, context: Context) -> pb.Worker:  # noqa: N802
        offer = self._work.offer
        return pb.Worker(
            version=__version__,
            device=offer.device,
            presets=offer.presets,
            slots=self._settings.slots,
            free_slots=self._runs.free_slots,
            queued=self._runs.queued,
            draining=self._runs.draining,
            jobs=self._runs.live,
            memory_bytes=offer.memory_bytes,
            points_version=offer.points_version,
            central=offer.central,
        )


async def _welcomed(chunks: AsyncIterator[pb.Chunk], context: Context) -> AsyncIterator[pb.Chunk]:
    """The chunks; whoever reads the first has admitted the upload, which the caller hears as initial metadata."""
    await context.send_initial_metadata(())
    async for chunk in chunks:
        yield chunk


async def _refuse(context: Context, refused: RefusedError, chunks: AsyncIterator[pb.Chunk]) -> NoReturn:
    """Answer with the status, after hearing out a caller who did not wait to be admitted."""
    await heard_out(chunks)
    await context.abort(refused.status, refused.details)


def serve(settings: EdgeSettings, work: Work) -> int:
    """Serve until SIGTERM or SIGINT, drain, and return the process's exit status: 0, or 1 when it could not start.

    A second signal ends the drain at once.
    """
    scratch = Scratch(settings.scratch)
    try:
        with scratch.held():
            asyncio.run(_serve(settings, work, scratch))
    except (AddressError, SettingsError) as error:
        _log.error("%s", error)
        return 1
    return 0


class AddressError(RuntimeError):
    """The worker cannot listen where it was told to."""


class EdgeServer:
    """The worker's calls, its health and, when asked for, reflection on one port. Built and used on the event loop.

    Raises SettingsError where the settings' certificate, key or token cannot be used.
    """

    def __init__(self, settings: EdgeSettings, work: Work, scratch: Scratch) -> None:
        self._settings = settings
        self._runs = Runs(work, scratch, slots=settings.slots, queue=settings.queue)
        self._door = open_door(settings)
        guards = [TokenDoor(self._door.token)] if self._door.token else []
        self._server = grpc.aio.server(interceptors=guards, options=OPTIONS)
        self._health = health.aio.HealthServicer()
        servicer = EdgeServicer(settings, work, self._runs, Inspections(work, scratch))
        edge_pb2_grpc.add_EdgeReconstructionServicer_to_server(servicer, self._server)  # type: ignore[no-untyped-call]
        health_pb2_grpc.add_HealthServicer_to_server(self._health, self._server)
        if settings.reflection:
            _add_reflection(self._server)

    async def start(self) -> int:
        """Listen; the port. Raises AddressError."""
        port = _bind(self._server, self._settings, self._door)
        await self._health.set(SERVICE, health_pb2.HealthCheckResponse.SERVING)
        await self._server.start()
        return port

    async def drain(self, hurry: asyncio.Event) -> None:
        """Say NOT_SERVING, take no more jobs, give the running ones their time, tell everybody, and stop."""
        await self._health.enter_graceful_shutdown()
        await self._runs.drain(self._settings.drain_s, hurry)
        await self._server.stop(FAREWELL_S)


async def _serve(settings: EdgeSettings, work: Work, scratch: Scratch) -> None:
    server = EdgeServer(settings, work, scratch)
    with _signals() as (leave, hurry):
        _announce(settings, await server.start())
        await leave.wait()
        _log.info("draining: running jobs have %.0f s", settings.drain_s)
        await server.drain(hurry)
    _log.info("drained")


def _add_reflection(server: grpc.aio.Server) -> None:
    from grpc_reflection.v1alpha import reflection

    reflection.enable_server_reflection((SERVICE, health.SERVICE_NAME, reflection.SERVICE_NAME), server)


def _bind(server: grpc.aio.Server, settings: EdgeSettings, door: Door) -> int:
    """The port; gRPC's own error tells nothing a person could act on."""
    host = f"[{settings.host}]" if ":" in settings.host else settings.host
    address, credentials = f"{host}:{settings.port}", door.credentials
    try:
        return server.add_secure_port(address, credentials) if credentials else server.add_insecure_port(address)
    except RuntimeError:
        raise AddressError(f"cannot listen on {address}: set EDGE_HOST or EDGE_PORT") from None


def _announce(settings: EdgeSettings, port: int) -> None:
    _log.info("settings: %s", json.dumps(settings.describe()))
    _log.info("listening on %s:%d", settings.host, port)
    if not settings.loopback and not settings.token.get_secret_value():
        said = "EDGE_HOST=%s: without EDGE_TOKEN there are no access keys, so whoever reaches this port may run jobs"
        _log.warning(said, settings.host)


@contextmanager
def _signals() -> Iterator[tuple[asyncio.Event, asyncio.Event]]:
    """(leave, hurry): set by the first and the second SIGTERM or SIGINT."""
    leave, hurry = asyncio.Event(), asyncio.Event()
    loop = asyncio.get_running_loop()

    def heard() -> None:
        (hurry if leave.is_set() else leave).set()

    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, heard)
    try:
        yield leave, hurry
    finally:
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.remove_signal_handler(number)
