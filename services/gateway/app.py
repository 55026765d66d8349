"""The gateway: HTTP in, gRPC out. `create_app` builds it, `serve` runs it."""

from __future__ import annotations

import asyncio
import json
import logging
import signal
import socket
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager, suppress

import uvicorn
from fastapi import FastAPI
from sqlalchemy.exc import SQLAlchemyError
from starlette.middleware.cors import CORSMiddleware
from starlette.middleware.gzip import GZipMiddleware

import services
from services.gateway import errors
from services.gateway.edge import EdgePool
from services.gateway.instance import FolderInUse, instance
from services.gateway.jobs.conductor import Means
from services.gateway.jobs.desk import Desk
from services.gateway.jobs.dispatcher import Dispatcher
from services.gateway.jobs.store import JobStore
from services.gateway.jobs.tables import open_engine
from services.gateway.jobs.transitions import Retry
from services.gateway.metrics import Metrics
from services.gateway.middleware import Around
from services.gateway.routes import assets, captures, collections, files, health, jobs, pages
from services.gateway.settings import GatewaySettings, open_way_to_workers
from services.logs import configure
from services.storage.signing import NO_KEYS, Keys
from services.storage.store import Store
from services.strict_settings import SettingsError

_GRACE_S = 5  # that answers under way get when the gateway is told to stop

_log = logging.getLogger(__name__)


def create_app(settings: GatewaySettings, store: Store, keys: Keys = NO_KEYS) -> FastAPI:
    """The app; its database, its dispatcher and its connections live from startup to shutdown.

    Routes find what they need in `app.state`: settings, store, keys, rows_of, edge, metrics, desk, dispatcher.
    Raises SettingsError where the workers' certificate or token cannot be used.
    """
    app = FastAPI(
        title="capture2vr",
        version=services.__version__,
        summary="Captures in, assets for VR out.",
        lifespan=_lifespan,
        docs_url=None,  # its page loads scripts from elsewhere; the document itself is at /openapi.json
        redoc_url=None,
    )
    metrics = Metrics()
    app.state.settings = settings
    app.state.store = store
    app.state.keys = keys
    app.state.rows_of = collections.kept_rows(store)
    app.state.metrics = metrics
    app.state.edge = EdgePool(
        settings.workers,
        silence_s=settings.silence_s,
        job_timeout_s=settings.job_timeout_s,
        caller=open_way_to_workers(settings),
    )
    errors.install(app)
    for routes in (captures, jobs, assets, collections, files, health, pages):
        app.include_router(routes.router)
    # Scripts shrink to a quarter: 2.5 MB would be a second of a first visit at 20 Mbit/s.
    app.mount("/web", GZipMiddleware(pages.Web(directory=pages.WEB), compresslevel=6), name="web")
    if settings.cors_origins:
        app.add_middleware(
            CORSMiddleware,
            allow_origins=settings.cors_origins,
            allow_methods=["GET", "POST"],
            allow_headers=["Content-Type", "Idempotency-Key", "Last-Event-ID"],
            expose_headers=["ETag", "Location", "X-Request-ID"],
        )
    app.add_middleware(Around, metrics=metrics, max_upload_bytes=settings.max_upload_bytes)
    return app


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    settings: GatewaySettings = app.state.settings
    edge: EdgePool = app.state.edge
    async with AsyncExitStack() as stack:
        holder = stack.enter_context(instance(settings.data_dir))
        engine = open_engine(settings.database)
        stack.callback(engine.dispose)
        desk = Desk(JobStore(engine))
        stack.callback(desk.close)
        stack.push_async_callback(edge.close)
        means = Means(
            desk=desk,
            edge=edge,
            store=app.state.store,
            retry=Retry(settings.max_attempts, settings.retry_s),
            attach_for_s=settings.attach_for_s,
            ended=app.state.metrics.ended,
        )
        app.state.desk = desk
        app.state.dispatcher = Dispatcher(means, holder=holder, lease_s=settings.lease_s)
        for background in (app.state.dispatcher.run(), desk.follow_others()):
            task = asyncio.create_task(background)
            task.add_done_callback(_report_death)
            stack.push_async_callback(_stop, task)
        yield


async def _stop(task: asyncio.Task[None]) -> None:
    task.cancel()
    with suppress(asyncio.CancelledError):
        await task


def _report_death(task: asyncio.Task[None]) -> None:
    """Background tasks end only when they are told to; anything else must be seen."""
    if not task.cancelled() and (error := task.exception()):
        _log.critical("a background task of the gateway died", exc_info=error)


def serve(settings: GatewaySettings, store: Store, keys: Keys = NO_KEYS) -> int:
    """Serve until SIGTERM or SIGINT; the process's exit status: 0, or 1 when it could not start."""
    configure(settings.log_level)
    try:
        app = create_app(settings, store, keys)
        with instance(settings.data_dir):
            open_engine(settings.database).dispose()
        listening = _listen(settings)
    # ImportError: the database's driver
    except (FolderInUse, OSError, SQLAlchemyError, ImportError, SettingsError) as error:
        _log.error("cannot start: %s", error)
        return 1
    with listening:
        _announce(settings, listening.getsockname()[1])
        if not keys.believed:
            _log.warning("collections are believed as they are: name the keys in STORAGE_SIGNING_KEY or _TRUSTED_KEYS")
        config = uvicorn.Config(
            app,
            log_config=None,
            access_log=False,
            timeout_graceful_shutdown=_GRACE_S,
            server_header=False,
        )
        server = uvicorn.Server(config)
        # The server raises the signal that stopped it once more when it is done: being told to stop is no failure.
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: None)
        server.run(sockets=[listening])
    return 0 if server.started else 1


def _listen(settings: GatewaySettings) -> socket.socket:
    """Raises OSError."""
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    listening = socket.create_server((settings.host, settings.port), family=family)
    # asyncio does this for sockets that it opens itself only. Without it every answer of two segments, head and body,
    # waits 40 ms for the client's delayed acknowledgement.
    listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return listening


def _announce(settings: GatewaySettings, port: int) -> None:
    _log.info("settings: %s", json.dumps(settings.describe()))
    _log.info("listening on http://%s:%d", settings.host, port)
    if settings.is_public:
        _log.warning("GATEWAY_HOST=%s: there are no access keys, so whoever reaches this may use it", settings.host)
