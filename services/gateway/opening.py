"""Open all parts of a gateway, in the order in which they need each other; an exit stack closes them again."""

from __future__ import annotations

from contextlib import AsyncExitStack, closing
from dataclasses import dataclass

from sqlalchemy.engine import Engine

from capture2vr.gateway.access.authentication import Authentication
from capture2vr.gateway.access.guesses import Guesses
from capture2vr.gateway.access.limits import Limits
from capture2vr.gateway.access.readers import ReadersCache
from capture2vr.gateway.access.shares import ShareStore
from capture2vr.gateway.access.sharing import Sharing
from capture2vr.gateway.access.store import AccessStore
from capture2vr.gateway.access.usage import Usage
from capture2vr.gateway.backup.backup_records import BackupRecords
from capture2vr.gateway.backup.scrub import Scrub
from capture2vr.gateway.backup.snapshots import Snapshots
from capture2vr.gateway.database.database import open_engine
from capture2vr.gateway.database.disk_reserve import DiskReserve
from capture2vr.gateway.dispatch.dispatcher import Dispatcher
from capture2vr.gateway.dispatch.downloads import Downloads
from capture2vr.gateway.dispatch.run_supervisor import Dependencies
from capture2vr.gateway.gateway import (
    AccessParts,
    CaptureParts,
    Gateway,
    RecordParts,
    SceneParts,
    UpkeepParts,
    WebhookParts,
)
from capture2vr.gateway.jobs.async_store import AsyncJobStore
from capture2vr.gateway.jobs.state_machine import Retry
from capture2vr.gateway.jobs.store import JobStore
from capture2vr.gateway.metrics.metrics import Metrics
from capture2vr.gateway.pictures.picture_processes import PictureProcesses
from capture2vr.gateway.records.audit_log import AuditLog, AuditStore
from capture2vr.gateway.records.deletions import DeletionStore
from capture2vr.gateway.records.tenant_data import TenantData
from capture2vr.gateway.resumable.store import UploadStore
from capture2vr.gateway.resumable.uploads import ResumableUploads
from capture2vr.gateway.scenes.news import SceneNews
from capture2vr.gateway.scenes.reads import SceneReads
from capture2vr.gateway.search.indexes import SearchIndexes
from capture2vr.gateway.settings import GatewaySettings
from capture2vr.gateway.uploads.accept import Uploads
from capture2vr.gateway.uploads.check_processes import CheckProcesses
from capture2vr.gateway.webhooks.deliveries import Deliveries
from capture2vr.gateway.webhooks.outbox import Outbox
from capture2vr.gateway.webhooks.send import Sender
from capture2vr.gateway.webhooks.store import WebhookStore
from capture2vr.gateway.workers.worker_client import WorkerPool
from capture2vr.process.grpc_security import ClientCredentials, first_expiry
from capture2vr.storage.catalogue.reader import tenant_parts
from capture2vr.storage.catalogue.signing import Keys
from capture2vr.storage.local import LocalStore
from capture2vr.storage.store import Store


@dataclass(frozen=True, slots=True)
class Equipment:
    """What a gateway is started with. credentials: for calls to the workers; metrics_token: for GET /metrics, or "" """

    settings: GatewaySettings
    store: Store
    keys: Keys
    credentials: ClientCredentials
    metrics_token: str = ""


@dataclass(frozen=True, slots=True)
class _Ground:
    """The parts that the others stand on."""

    equipment: Equipment
    engine: Engine
    metrics: Metrics
    checks: CheckProcesses
    pictures: PictureProcesses
    access: AccessParts
    audit: AuditLog
    job_store: AsyncJobStore
    workers: WorkerPool
    search: SearchIndexes


def open_gateway(equipment: Equipment, holder: str, stack: AsyncExitStack) -> Gateway:
    """Open a gateway on the event loop that serves its requests; `stack` closes it. Raises SQLAlchemyError, OSError.

    holder  its id in the lease table
    """
    ground = _open_ground(equipment, stack)
    captures, webhooks = _open_captures(ground, stack), _webhooks(ground)
    return Gateway(
        settings=equipment.settings,
        store=equipment.store,
        keys=equipment.keys,
        parts=tenant_parts(equipment.store),
        search=ground.search,
        metrics=ground.metrics,
        workers=ground.workers,
        job_store=ground.job_store,
        dispatcher=_dispatcher(ground, holder),
        downloads=_open_downloads(ground, stack),
        access=ground.access,
        captures=captures,
        scenes=_scenes(ground),
        webhooks=webhooks,
        records=RecordParts(ground.audit, _tenant_data(ground, captures, webhooks)),
        upkeep=_upkeep(ground),
    )


def _open_ground(equipment: Equipment, stack: AsyncExitStack) -> _Ground:
    engine = open_engine(equipment.settings.database)
    stack.callback(engine.dispose)
    checks = stack.enter_context(closing(CheckProcesses()))
    checks.start()
    return _Ground(
        equipment=equipment,
        engine=engine,
        metrics=_metrics(equipment),
        checks=checks,
        pictures=stack.enter_context(closing(PictureProcesses())),
        access=_open_access(equipment, engine, stack),
        audit=stack.enter_context(closing(AuditLog(AuditStore(engine)))),
        job_store=stack.enter_context(closing(AsyncJobStore(JobStore(engine)))),
        workers=_open_workers(equipment, stack),
        search=_open_search(equipment.settings, stack),
    )


def _metrics(equipment: Equipment) -> Metrics:
    metrics = Metrics()
    if equipment.credentials.ca:
        metrics.vitals.show_expiry("GATEWAY_EDGE_CA", first_expiry(equipment.credentials.ca))
    return metrics


def _open_access(equipment: Equipment, engine: Engine, stack: AsyncExitStack) -> AccessParts:
    settings, store = equipment.settings, equipment.store
    authentication = Authentication(AccessStore(engine), told_open=settings.open, may_open=not settings.is_public)
    stack.push_async_callback(authentication.close)
    return AccessParts(
        authentication=authentication,
        limits=Limits(settings, authentication),
        usage=Usage(authentication, store),
        sharing=Sharing(ShareStore(engine), authentication),
        readers=ReadersCache(store),
        code_guesses=Guesses("code"),
        password_guesses=Guesses("password"),
        metrics_token=equipment.metrics_token,
    )


def _open_workers(equipment: Equipment, stack: AsyncExitStack) -> WorkerPool:
    settings = equipment.settings
    workers = WorkerPool(
        settings.workers,
        silence_s=settings.silence_s,
        job_timeout_s=settings.job_timeout_s,
        credentials=equipment.credentials,
    )
    stack.push_async_callback(workers.close)
    return workers


def _open_search(settings: GatewaySettings, stack: AsyncExitStack) -> SearchIndexes:
    return stack.enter_context(closing(SearchIndexes(settings.data_dir / "search", settings.search_bytes)))


def _open_captures(ground: _Ground, stack: AsyncExitStack) -> CaptureParts:
    settings = ground.equipment.settings
    uploads = Uploads(settings, ground.workers, ground.checks)
    resumable = ResumableUploads(UploadStore(ground.engine), settings.data_dir / "uploads", settings.upload_expires_s)
    return CaptureParts(uploads, stack.enter_context(closing(resumable)), ground.pictures)


def _open_downloads(ground: _Ground, stack: AsyncExitStack) -> Downloads:
    downloads = Downloads(ground.workers, ground.equipment.store)
    stack.push_async_callback(downloads.close)
    return downloads


def _scenes(ground: _Ground) -> SceneParts:
    reads = SceneReads(ground.equipment.store)
    return SceneParts(reads, SceneNews(ground.engine, reads, ground.access.readers))


def _webhooks(ground: _Ground) -> WebhookParts:
    outbox, sender = Outbox(ground.engine), Sender(allow_private=ground.equipment.settings.webhook_private)
    deliveries = Deliveries(outbox, sender, ground.metrics.observe_webhook)
    return WebhookParts(WebhookStore(ground.engine), outbox, deliveries)


def _tenant_data(ground: _Ground, captures: CaptureParts, webhooks: WebhookParts) -> TenantData:
    return TenantData(
        ground.equipment.store,
        ground.equipment.keys,
        ground.access.authentication,
        ground.access.usage,
        ground.job_store,
        DeletionStore(ground.engine),
        ground.access.sharing.store,
        webhooks.outbox,
        webhooks.deliveries,
        captures.resumable.database,
        ground.search,
        ground.equipment.settings.jobs_days,
    )


def _dispatcher(ground: _Ground, holder: str) -> Dispatcher:
    settings = ground.equipment.settings
    dependencies = Dependencies(
        job_store=ground.job_store,
        workers=ground.workers,
        store=ground.equipment.store,
        retry=Retry(settings.max_attempts, settings.retry_s),
        attach_for_s=settings.attach_for_s,
        watch=ground.metrics.jobs,
    )
    return Dispatcher(dependencies, holder=holder, lease_s=settings.lease_s)


def _upkeep(ground: _Ground) -> UpkeepParts:
    settings, store = ground.equipment.settings, ground.equipment.store
    # A store that is no folder checks its disks itself.
    days = settings.scrub_days if isinstance(store, LocalStore) else 0.0
    scrub = Scrub(store, settings.data_dir / "scrub.json", days)
    snapshots = Snapshots(settings.database, settings.snapshots_dir, settings.snapshots)
    return UpkeepParts(scrub, snapshots, DiskReserve(settings.data_dir), BackupRecords(ground.engine))
