"""gRPC server of an edge worker: its calls, health checks and shutdown. The computation is passed in as `Work`."""

from __future__ import annotations

import asyncio
import json
import logging
import signal
from collections.abc import AsyncIterator, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, NoReturn

import grpc
from grpc_health.v1 import health, health_pb2, health_pb2_grpc

from capture2vr import __version__
from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.api import edge_pb2_grpc
from capture2vr.edge.api.grpc_client import KEEPALIVE, MESSAGE_LIMITS
from capture2vr.edge.worker.authentication import TokenAuthentication, drain_messages
from capture2vr.edge.worker.downloads import DownloadMaker
from capture2vr.edge.worker.inspections import Inspections
from capture2vr.edge.worker.job_queue import JobQueue
from capture2vr.edge.worker.job_request import ReconstructionRequest, RefusedError, checked_box
from capture2vr.edge.worker.job_run import Work
from capture2vr.edge.worker.metrics import WorkerMetrics
from capture2vr.edge.worker.scratch import Scratch
from capture2vr.edge.worker.settings import EdgeSettings, certificate_expiries, refuse_without_token, server_security
from capture2vr.edge.worker.upload import first_header
from capture2vr.process.grpc_security import ServerSecurity
from capture2vr.process.strict_settings import SettingsError
from capture2vr.process.traces import start_tracing

_log = logging.getLogger(__name__)

SERVICE = pb.DESCRIPTOR.services_by_name["EdgeReconstruction"].full_name

OPTIONS = (
    *MESSAGE_LIMITS,
    *KEEPALIVE,
    ("grpc.keepalive_permit_without_calls", 1),
    # Gateways ping every 20 s; a server with gRPC's default limit would disconnect them with ENHANCE_YOUR_CALM.
    ("grpc.http2.min_recv_ping_interval_without_data_ms", 5_000),
    # A second worker on the same port must fail to start, not silently take half the calls.
    ("grpc.so_reuseport", 0),
)

STREAM_END_S = 2.0
"""Seconds that open streams get to deliver their terminal event once every job has ended."""

Context = grpc.aio.ServicerContext[Any, Any]

_JOB_UNKNOWN = "JOB_UNKNOWN: this worker does not know the job"
_OUT_OF_MEMORY = "OUT_OF_MEMORY: this worker was killed because its jobs wanted more memory than it has, and lost them"


class EdgeServicer(edge_pb2_grpc.EdgeReconstructionServicer):
    """Implements the wire's calls with a worker's `JobQueue`, `Inspections` and `DownloadMaker`."""

    def __init__(
        self,
        settings: EdgeSettings,
        work: Work,
        runs: JobQueue,
        inspections: Inspections,
        downloads: DownloadMaker,
        *,
        out_of_memory: bool,
    ) -> None:
        self._settings = settings
        self._out_of_memory = out_of_memory
        self._work = work
        self._runs = runs
        self._inspections = inspections
        self._downloads = downloads

    async def Reconstruct(self, request_iterator: AsyncIterator[pb.Chunk], context: Context) -> AsyncIterator[pb.Event]:  # noqa: N802
        chunks = aiter(request_iterator)
        try:
            header = await first_header(chunks, limit_bytes=self._settings.max_capture_bytes)
            request = ReconstructionRequest.of(header, self._work.offer)
            run = await self._runs.take(request, _admitting(chunks, context), header.capture_bytes)
        except RefusedError as refused:
            await _refuse(context, refused, chunks)
        async for event in run.log.follow():
            yield event

    async def Inspect(self, request_iterator: AsyncIterator[pb.Chunk], context: Context) -> pb.Inspection:  # noqa: N802
        chunks = aiter(request_iterator)
        try:
            header = await first_header(chunks, limit_bytes=self._settings.max_capture_bytes)
            box = checked_box(header)
            return await self._inspections.inspect(_admitting(chunks, context), header.capture_bytes, box)
        except RefusedError as refused:
            await _refuse(context, refused, chunks)

    async def Attach(self, request: pb.AttachRequest, context: Context) -> AsyncIterator[pb.Event]:  # noqa: N802
        run = self._runs.find(request.job, request.token)
        if run is None:
            await context.abort(grpc.StatusCode.NOT_FOUND, _OUT_OF_MEMORY if self._out_of_memory else _JOB_UNKNOWN)
        if request.after_seq > run.log.last_seq:
            fault = f"this run has {run.log.last_seq} events so far, not {request.after_seq}"
            await context.abort(grpc.StatusCode.OUT_OF_RANGE, f"SEQ_UNKNOWN: {fault}")
        async for event in run.log.follow(request.after_seq):
            yield event

    async def Cancel(self, request: pb.CancelRequest, context: Context) -> pb.CancelReply:  # noqa: N802
        return pb.CancelReply(was_running=self._runs.cancel(request.job, request.token))

    async def Yield(self, request: pb.YieldRequest, context: Context) -> pb.YieldReply:  # noqa: N802
        return pb.YieldReply(yields=self._runs.make_room(request.job, request.token))

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
            jobs=self._runs.live_jobs,
            memory_bytes=offer.memory_bytes,
            points_version=offer.points_version,
            central=offer.central,
        )

    async def MakeDownload(self, request: pb.DownloadRequest, context: Context) -> pb.Download:  # noqa: N802
        try:
            return await self._downloads.make(request)
        except RefusedError as refused:
            await context.abort(refused.status, refused.details)


async def _admitting(chunks: AsyncIterator[pb.Chunk], context: Context) -> AsyncIterator[pb.Chunk]:
    """Yield the chunks of an upload; before the first, admit it by sending the call's initial metadata."""
    await _send_initial_metadata(context)
    async for chunk in chunks:
        yield chunk


async def _send_initial_metadata(context: Context) -> None:
    """Send the call's initial metadata, to the end even when cancelled.

    gRPC takes metadata that a cancelled coroutine was sending for unsent and sends it again with the refusal's status:
    that fails, and the caller would wait for ever.
    """
    sending = asyncio.ensure_future(context.send_initial_metadata(()))
    try:
        await asyncio.shield(sending)
    except asyncio.CancelledError:
        await sending
        raise


async def _refuse(context: Context, refused: RefusedError, chunks: AsyncIterator[pb.Chunk]) -> NoReturn:
    """End the call with the refusal's status, after draining the messages of a caller that did not wait for it."""
    await drain_messages(chunks)
    await context.abort(refused.status, refused.details)


def serve(settings: EdgeSettings, work: Work, *, out_of_memory: bool = False) -> int:
    """Serve until SIGTERM or SIGINT, then drain; return the exit status: 0, or 1 when the worker could not start.

    A second signal ends the drain at once.
    out_of_memory  whether the kernel has killed the worker before this one for that: callers of its jobs are told
    """
    scratch = Scratch(settings.scratch)
    try:
        start_tracing("capture2vr-edge")
        with scratch.claim(), scratch.with_temporary_files():
            asyncio.run(_serve(settings, work, scratch, out_of_memory=out_of_memory))
    except (AddressError, SettingsError) as error:
        _log.error("%s", error)
        return 1
    return 0


class AddressError(RuntimeError):
    """The worker cannot listen on the address of its settings."""


class EdgeServer:
    """Serves the worker's calls, health checks and, if enabled, reflection on one port. Used on the event loop only.

    Raises SettingsError where the settings' certificate, key or token cannot be used, and where a token is missing.
    """

    def __init__(self, settings: EdgeSettings, work: Work, scratch: Scratch, *, out_of_memory: bool = False) -> None:
        self._settings = settings
        offer = work.offer
        self.metrics = WorkerMetrics(
            version=__version__, device=offer.device, slots=settings.slots, memory_bytes=offer.memory_bytes
        )
        self._runs = JobQueue(work, scratch, self.metrics, slots=settings.slots, queue=settings.queue)
        refuse_without_token(settings)
        self._security = server_security(settings)
        self.metrics.show_expiries(certificate_expiries(settings))
        interceptors = [TokenAuthentication(self._security.token)] if self._security.token else []
        self._server = grpc.aio.server(interceptors=interceptors, options=OPTIONS)
        self._health = health.aio.HealthServicer()
        inspections, self._downloads = Inspections(work, scratch), DownloadMaker(work, scratch)
        servicer = EdgeServicer(settings, work, self._runs, inspections, self._downloads, out_of_memory=out_of_memory)
        edge_pb2_grpc.add_EdgeReconstructionServicer_to_server(servicer, self._server)  # type: ignore[no-untyped-call]
        health_pb2_grpc.add_HealthServicer_to_server(self._health, self._server)
        if settings.reflection:
            _add_reflection(self._server)

    async def start(self) -> int:
        """Start listening; return the port. Raises AddressError."""
        port = _bind(self._server, self._settings, self._security)
        await self._health.set(SERVICE, health_pb2.HealthCheckResponse.SERVING)
        await self._server.start()
        return port

    async def drain(self, hurry: asyncio.Event) -> None:
        """Shut down: report NOT_SERVING, refuse new jobs, wait `drain_s` for the running ones, end the streams, stop.

        hurry  ends the wait at once when it is set
        """
        await self._health.enter_graceful_shutdown()
        self._downloads.close()
        await self._runs.drain(self._settings.drain_s, hurry)
        await self._server.stop(STREAM_END_S)


async def _serve(settings: EdgeSettings, work: Work, scratch: Scratch, *, out_of_memory: bool) -> None:
    server = EdgeServer(settings, work, scratch, out_of_memory=out_of_memory)
    with _signals() as (stop, hurry), _metrics(settings, server.metrics):
        _announce(settings, await server.start())
        await stop.wait()
        _log.info("draining: running jobs have %.0f s to finish", settings.drain_s)
        await server.drain(hurry)
    _log.info("drained")


@contextmanager
def _metrics(settings: EdgeSettings, metrics: WorkerMetrics) -> Iterator[None]:
    """Serve the metrics during the block, where the settings have a port for them. Raises AddressError."""
    if not settings.metrics_port:
        yield
        return
    with ExitStack() as stack:
        try:
            port = stack.enter_context(metrics.serve(settings.metrics_host, settings.metrics_port))
        except OSError as error:
            why = (
                f"EDGE_METRICS_PORT: cannot listen on {settings.metrics_host}:{settings.metrics_port}: {error.strerror}"
            )
            raise AddressError(why) from None
        _log.info("metrics on http://%s:%d/metrics", settings.metrics_host, port)
        yield


def _add_reflection(server: grpc.aio.Server) -> None:
    from grpc_reflection.v1alpha import reflection

    reflection.enable_server_reflection((SERVICE, health.SERVICE_NAME, reflection.SERVICE_NAME), server)


def _bind(server: grpc.aio.Server, settings: EdgeSettings, security: ServerSecurity) -> int:
    """Bind the server to its address; return the port. Raises AddressError, because gRPC's own error has no reason."""
    host = f"[{settings.host}]" if ":" in settings.host else settings.host
    address = settings.host if settings.is_socket else f"{host}:{settings.port}"
    credentials = security.credentials
    try:
        return server.add_secure_port(address, credentials) if credentials else server.add_insecure_port(address)
    except RuntimeError:
        raise AddressError(f"cannot listen on {address}: choose another EDGE_HOST or EDGE_PORT") from None


def _announce(settings: EdgeSettings, port: int) -> None:
    _log.info("settings: %s", json.dumps(settings.describe()))
    _log.info("listening on %s", settings.host if settings.is_socket else f"{settings.host}:{port}")
    if settings.takes_strangers:
        _log.warning("EDGE_OPEN: everybody who reaches %s may run jobs, in the name of any tenant", settings.host)


@contextmanager
def _signals() -> Iterator[tuple[asyncio.Event, asyncio.Event]]:
    """Handle signals in the block: yield two events, set by the first and the second SIGTERM or SIGINT."""
    stop, hurry = asyncio.Event(), asyncio.Event()
    loop = asyncio.get_running_loop()

    def on_signal() -> None:
        (hurry if stop.is_set() else stop).set()

    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, on_signal)
    try:
        yield stop, hurry
    finally:
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.remove_signal_handler(number)
