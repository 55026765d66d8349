"""The gateway's HTTP application (FastAPI) and server: `create_app` builds the app, `serve` runs it with uvicorn."""

from __future__ import annotations

import asyncio
import json
import logging
import signal
import socket
import sys
import time
from collections.abc import AsyncIterator
from contextlib import AbstractContextManager, AsyncExitStack, asynccontextmanager, suppress
from functools import partial
from typing import Any

import uvicorn
from fastapi import FastAPI
from fastapi.responses import JSONResponse
from sqlalchemy.exc import SQLAlchemyError
from starlette.middleware.cors import CORSMiddleware
from starlette.middleware.gzip import GZipMiddleware

import capture2vr
from capture2vr.gateway import errors
from capture2vr.gateway.access.authentication import Authentication
from capture2vr.gateway.access.caller import Scope
from capture2vr.gateway.access.guesses import Guesses
from capture2vr.gateway.access.limits import Limits
from capture2vr.gateway.access.readers import ReadersCache
from capture2vr.gateway.access.shares import ShareStore
from capture2vr.gateway.access.sharing import Sharing
from capture2vr.gateway.access.store import AccessStore
from capture2vr.gateway.access.usage import Usage
from capture2vr.gateway.backup.scrub import Scrub
from capture2vr.gateway.backup.snapshots import Snapshots
from capture2vr.gateway.connections import ConnectionLimits, LimitedProtocol
from capture2vr.gateway.database.database import open_engine
from capture2vr.gateway.database.instance_lock import FolderInUse, Instance, lock_instance, lock_replica
from capture2vr.gateway.dispatch.dispatcher import Dispatcher
from capture2vr.gateway.dispatch.downloads import Downloads
from capture2vr.gateway.dispatch.run_supervisor import Dependencies
from capture2vr.gateway.jobs.async_store import AsyncJobStore
from capture2vr.gateway.jobs.other_gateways import OtherGateways
from capture2vr.gateway.jobs.state_machine import Retry
from capture2vr.gateway.jobs.store import JobStore
from capture2vr.gateway.metrics import Metrics
from capture2vr.gateway.middleware import RequestMiddleware
from capture2vr.gateway.pictures.picture_processes import PictureProcesses
from capture2vr.gateway.records.audit_log import AuditLog, AuditStore
from capture2vr.gateway.records.deletions import DeletionStore
from capture2vr.gateway.records.tenant_data import TenantData
from capture2vr.gateway.resumable import protocol
from capture2vr.gateway.resumable.expiry import Expiry
from capture2vr.gateway.resumable.store import UploadStore
from capture2vr.gateway.resumable.uploads import ResumableUploads
from capture2vr.gateway.routes import (
    access,
    assets,
    captures,
    collections,
    data,
    downloads,
    files,
    health,
    jobs,
    names,
    notes,
    pages,
    pictures,
    scene_events,
    scenes,
    service,
    shares,
    tenants,
    uploads,
    versions,
    visibility,
    webhooks,
)
from capture2vr.gateway.routes.access_rules import check_rules, describe_rules, needs
from capture2vr.gateway.scenes.news import CHANNEL, SceneNews
from capture2vr.gateway.scenes.reads import SceneReads
from capture2vr.gateway.settings import GatewaySettings, worker_credentials
from capture2vr.gateway.uploads.check_processes import CheckProcesses
from capture2vr.gateway.webhooks.deliveries import Deliveries
from capture2vr.gateway.webhooks.outbox import Outbox
from capture2vr.gateway.webhooks.send import Sender
from capture2vr.gateway.webhooks.store import WebhookStore
from capture2vr.gateway.workers.worker_client import WorkerPool
from capture2vr.process.logs import configure
from capture2vr.process.strict_settings import SettingsError
from capture2vr.process.traces import start_tracing
from capture2vr.storage.catalogue.signing import NO_KEYS, Keys
from capture2vr.storage.local import LocalStore
from capture2vr.storage.store import Store

# What pages of other origins may send and read, beside what uploads need.
_REQUEST_HEADERS = ("Authorization", "Content-Type", "Idempotency-Key", "If-Match", "Last-Event-ID")
_ANSWER_HEADERS = ("ETag", "Location", "RateLimit", "RateLimit-Policy", "Retry-After", "X-Request-ID")
_ROUTES = (
    *(captures, pictures, uploads, jobs, assets, versions, downloads, names, notes),
    *(collections, files, visibility, shares, scenes, scene_events),
    *(access, tenants, webhooks, data, health, service, pages),
)
_GRACE_S = 5  # for answers in progress when the gateway stops
# For which a busy thread keeps Python's lock while others wait. By default 5 ms, which beside a busy event loop each of
# a dozen statements of the jobs' thread waits for: then a claim took 114 ms, and with this 16.
_SWITCH_S = 0.0005

_log = logging.getLogger(__name__)


def create_app(settings: GatewaySettings, store: Store, keys: Keys = NO_KEYS) -> FastAPI:
    """Build the app. Its database, dispatcher and connections are opened at startup and closed at shutdown.

    Routes find their dependencies in `app.state`: settings, store, keys, load_rows, workers, metrics, authentication,
    limits, usage, check_processes, picture_processes, code_guesses, password_guesses, readers, scene_reads, scene_news,
    sharing, job_store, resumable, webhooks, outbox, deliveries, downloads, dispatcher.

    Raises SettingsError where the workers' certificate or token cannot be used.
    """
    app = FastAPI(
        title="capture2vr",
        version=capture2vr.__version__,
        summary="Upload phone captures, reconstruct them as meshes, and download the assets for VR.",
        lifespan=_lifespan,
        docs_url=None,  # that page loads scripts from another host; the document itself is at /openapi.json
        redoc_url=None,
        openapi_url=None,  # the route below, which needs a key
    )
    metrics = Metrics()
    app.state.settings = settings
    app.state.store = store
    app.state.keys = keys
    app.state.load_rows = collections.row_cache(store)
    app.state.metrics = metrics
    app.state.workers = WorkerPool(
        settings.workers,
        silence_s=settings.silence_s,
        job_timeout_s=settings.job_timeout_s,
        credentials=worker_credentials(settings),
    )
    errors.install_handlers(app)
    app.state.authentication = Authentication(told_open=settings.open, may_open=not settings.is_public)
    app.state.limits = Limits(settings, app.state.authentication)
    app.state.check_processes = CheckProcesses()
    app.state.picture_processes = PictureProcesses()
    app.state.usage = Usage(app.state.authentication, store)
    app.state.code_guesses = Guesses("code")
    app.state.password_guesses = Guesses("password")
    app.state.sharing = Sharing(app.state.authentication)
    app.state.audit = AuditLog()
    app.state.readers = ReadersCache(store)
    app.state.scene_reads = SceneReads(store)
    for module in _ROUTES:
        check_rules(module.router.routes)
        app.include_router(module.router)
    _add_openapi(app)
    # Compression makes scripts four times smaller: 2.5 MB would take a second of a first visit at 20 Mbit/s.
    app.mount("/web", GZipMiddleware(pages.WebFiles(directory=pages.WEB), compresslevel=6), name="web")
    if settings.cors_origins:
        app.add_middleware(
            CORSMiddleware,
            allow_origins=settings.cors_origins,
            allow_methods=["GET", "HEAD", "POST", "PUT", "PATCH", "DELETE"],
            allow_headers=[*_REQUEST_HEADERS, *protocol.REQUEST_HEADERS],
            expose_headers=[*_ANSWER_HEADERS, *protocol.ANSWER_HEADERS],
        )
    app.add_middleware(
        RequestMiddleware, metrics=metrics, limits=app.state.limits, audit=app.state.audit, settings=settings
    )
    return app


def _add_openapi(app: FastAPI) -> None:
    """Serve the OpenAPI document, with the access rules, to operators."""
    make_document = app.openapi

    def document() -> dict[str, Any]:
        if app.openapi_schema is None:
            made = make_document()
            for module in _ROUTES:
                describe_rules(module.router.routes, made)
        assert app.openapi_schema is not None
        return app.openapi_schema

    app.openapi = document  # type: ignore[method-assign]

    @app.get("/openapi.json", include_in_schema=False, dependencies=[needs(Scope.OPERATE)])
    async def get_openapi() -> JSONResponse:
        return JSONResponse(document())


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    workers: WorkerPool = app.state.workers
    async with AsyncExitStack() as stack:
        instance = stack.enter_context(_lock(app.state.settings))
        settings = app.state.settings = app.state.settings.model_copy(update={"data_dir": instance.folder})
        engine = open_engine(settings.database)
        stack.callback(engine.dispose)
        app.state.check_processes.start()
        stack.callback(app.state.check_processes.close)
        stack.callback(app.state.picture_processes.close)
        authentication: Authentication = app.state.authentication
        authentication.connect(AccessStore(engine))
        app.state.sharing.connect(ShareStore(engine))
        stack.push_async_callback(authentication.close)
        app.state.audit_store = AuditStore(engine)
        app.state.audit.connect(app.state.audit_store)
        stack.callback(app.state.audit.close)
        job_store = AsyncJobStore(JobStore(engine))
        stack.callback(job_store.close)
        stack.push_async_callback(workers.close)
        dependencies = Dependencies(
            job_store=job_store,
            workers=workers,
            store=app.state.store,
            retry=Retry(settings.max_attempts, settings.retry_s),
            attach_for_s=settings.attach_for_s,
            on_job_ended=app.state.metrics.observe_job,
        )
        app.state.job_store = job_store
        app.state.scrub = Scrub(app.state.store, settings.data_dir / "scrub.json", _scrub_days(app))
        app.state.snapshots = Snapshots(settings.database, settings.snapshots_dir, settings.snapshots)
        resumable = ResumableUploads(UploadStore(engine), settings.data_dir / "uploads", settings.upload_expires_s)
        stack.callback(resumable.close)
        app.state.resumable = resumable
        app.state.webhooks = WebhookStore(engine)
        sender = Sender(allow_private=settings.webhook_private)
        app.state.outbox = Outbox(engine)
        app.state.deliveries = Deliveries(app.state.outbox, sender, app.state.metrics.observe_webhook)
        app.state.data = TenantData(
            app.state.store,
            app.state.keys,
            authentication,
            app.state.usage,
            job_store,
            DeletionStore(engine),
            app.state.sharing.store,
            app.state.outbox,
            app.state.deliveries,
            resumable.database,
        )
        app.state.downloads = Downloads(workers, app.state.store)
        stack.push_async_callback(app.state.downloads.close)
        app.state.dispatcher = Dispatcher(dependencies, holder=instance.id, lease_s=settings.lease_s)
        dispatcher: Dispatcher = app.state.dispatcher
        news = app.state.scene_news = SceneNews(engine, app.state.scene_reads, app.state.readers)
        others = OtherGateways(
            job_store,
            wake=dispatcher.wake,
            cancel=dispatcher.cancel,
            channels={CHANNEL: news.hear},
            on_connected=news.look_again,
        )
        for background in (
            dispatcher.run(),
            others.watch(),
            news.tell(),
            authentication.store_use(),
            app.state.deliveries.run(),
            app.state.snapshots.run(),
            app.state.scrub.run(),
            Expiry(resumable, app.state.store, app.state.usage.add).run(),
            app.state.data.keep_retention(),
        ):
            task = asyncio.create_task(background)
            task.add_done_callback(_report_death)
            stack.push_async_callback(_stop, task)
        yield


def _lock(settings: GatewaySettings) -> AbstractContextManager[Instance]:
    """Lock the data folder: for this gateway alone, or beside others that share a database server."""
    return (lock_instance if settings.database.startswith("sqlite") else lock_replica)(settings.data_dir)


def _scrub_days(app: FastAPI) -> float:
    """Return the days between two scrubs: 0 for a store that is no folder, which checks its disks itself."""
    settings: GatewaySettings = app.state.settings
    return settings.scrub_days if isinstance(app.state.store, LocalStore) else 0.0


async def _stop(task: asyncio.Task[None]) -> None:
    task.cancel()
    with suppress(asyncio.CancelledError):
        await task


def _report_death(task: asyncio.Task[None]) -> None:
    """Log an exception that ended a background task. These tasks should only end by being cancelled."""
    if not task.cancelled() and (error := task.exception()):
        _log.critical("a background task of the gateway ended with an error; restart the gateway", exc_info=error)


def serve(settings: GatewaySettings, store: Store, keys: Keys = NO_KEYS) -> int:
    """Serve until SIGTERM or SIGINT, and return the exit status: 0, or 1 when the gateway could not start."""
    configure(settings.log_level)
    sys.setswitchinterval(_SWITCH_S)
    try:
        start_tracing("capture2vr-gateway")
        app = create_app(settings, store, keys)
        with _lock(settings):
            refuse_without_keys(settings)
        listening = _listen(settings)
    # ImportError: the database's driver is not installed
    except (FolderInUse, OSError, SQLAlchemyError, ImportError, SettingsError) as error:
        _log.error("cannot start: %s", error)
        return 1
    with listening:
        _announce(settings, listening.getsockname()[1])
        if not keys.verification_keys:
            _log.warning("signatures of collections are not checked: set STORAGE_SIGNING_KEY or STORAGE_TRUSTED_KEYS")
        server = uvicorn.Server(server_config(app, settings))
        # uvicorn raises the signal that stopped it again at the end; ignored, because a requested stop is no failure.
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: None)
        server.run(sockets=[listening])
    return 0 if server.started else 1


def server_config(app: FastAPI, settings: GatewaySettings) -> uvicorn.Config:
    """Return the HTTP server's configuration for an app, with the limits of connections."""
    metrics: Metrics = app.state.metrics
    limits = ConnectionLimits(settings.limit_address_connections, metrics.observe_refused_connection)
    protocol: Any = partial(LimitedProtocol, limits)
    return uvicorn.Config(
        app,
        http=protocol,
        ws="none",
        log_config=None,
        access_log=False,
        timeout_graceful_shutdown=_GRACE_S,
        server_header=False,
    )


def refuse_without_keys(settings: GatewaySettings) -> None:
    """Raises SettingsError for a gateway that other machines can reach without an access key, unless `open` is set.

    Opens the database, brings its schema up to date, and stores the operator's key of the settings.
    """
    engine = open_engine(settings.database)
    try:
        if secret := settings.operator_key.get_secret_value():
            try:
                stored = AccessStore(engine).ensure_key(secret, "GATEWAY_OPERATOR_KEY")
            except ValueError as error:
                raise SettingsError(f"GATEWAY_OPERATOR_KEY: {error}") from None
            if why := stored.refusal(time.time()):
                _log.warning("GATEWAY_OPERATOR_KEY: %s is %s, and stays so; name another one", stored.id, why)
        if settings.is_public and not settings.open and not AccessStore(engine).has_keys():
            raise SettingsError(
                f"other machines can reach {settings.reached_host}, and there are no access keys: create one with "
                "`capture2vr keys create`, or let everybody in with --open (GATEWAY_OPEN=true)"
            )
    finally:
        engine.dispose()


def _listen(settings: GatewaySettings) -> socket.socket:
    """Open the listening socket. Raises OSError."""
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    listening = socket.create_server((settings.host, settings.port), family=family)
    # asyncio sets this only for sockets that it opens itself. Without it, an answer of two TCP segments (head and body)
    # waits 40 ms for the client's delayed acknowledgement.
    listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return listening


def _announce(settings: GatewaySettings, port: int) -> None:
    _log.info("settings: %s", json.dumps(settings.describe()))
    _log.info("listening on http://%s:%d", settings.host, port)
    if settings.open and settings.is_public:
        _log.warning("GATEWAY_OPEN: everybody who reaches this port owns all that is in it; no keys are asked for")
    elif not settings.is_public:
        _log.info("until the first access key is created, everybody on this machine is let in")
