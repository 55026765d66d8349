"""A running gateway as one object: what routes, access rules, middleware and background tasks work with.

It is built whole when the app starts. A route asks for it with a parameter `gateway: GatewayOf`, and what has only the
request with `gateway_of`. The app keeps it in the one field of its state, which this module alone touches.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, FastAPI, Request

from capture2vr.gateway.access.authentication import Authentication
from capture2vr.gateway.access.guesses import Guesses
from capture2vr.gateway.access.limits import Limits
from capture2vr.gateway.access.readers import ReadersCache
from capture2vr.gateway.access.sharing import Sharing
from capture2vr.gateway.access.usage import Usage
from capture2vr.gateway.backup.backup_records import BackupRecords
from capture2vr.gateway.backup.scrub import Scrub
from capture2vr.gateway.backup.snapshots import Snapshots
from capture2vr.gateway.database.disk_reserve import DiskReserve
from capture2vr.gateway.dispatch.dispatcher import Dispatcher
from capture2vr.gateway.dispatch.downloads import Downloads
from capture2vr.gateway.jobs.async_store import AsyncJobStore
from capture2vr.gateway.metrics.metrics import Metrics
from capture2vr.gateway.pictures.picture_processes import PictureProcesses
from capture2vr.gateway.records.audit_log import AuditLog
from capture2vr.gateway.records.tenant_data import TenantData
from capture2vr.gateway.resumable.uploads import ResumableUploads
from capture2vr.gateway.scenes.news import SceneNews
from capture2vr.gateway.scenes.reads import SceneReads
from capture2vr.gateway.search.indexes import SearchIndexes
from capture2vr.gateway.settings import GatewaySettings
from capture2vr.gateway.uploads.accept import Uploads
from capture2vr.gateway.webhooks.deliveries import Deliveries
from capture2vr.gateway.webhooks.outbox import Outbox
from capture2vr.gateway.webhooks.store import WebhookStore
from capture2vr.gateway.workers.worker_client import WorkerPool
from capture2vr.storage.catalogue.reader import TreeParts
from capture2vr.storage.catalogue.signing import Keys
from capture2vr.storage.store import Store


@dataclass(frozen=True, slots=True)
class AccessParts:
    """Who makes a request, how often, and what it may read.

    code_guesses, password_guesses  tries of pairing codes, and of passwords of shares
    metrics_token                   with which metrics are read, besides access keys; "": with those alone
    """

    authentication: Authentication
    limits: Limits
    usage: Usage
    sharing: Sharing
    readers: ReadersCache
    code_guesses: Guesses
    password_guesses: Guesses
    metrics_token: str


@dataclass(frozen=True, slots=True)
class CaptureParts:
    """How captures come in, by one request or by many, and how their photos are shown."""

    uploads: Uploads
    resumable: ResumableUploads
    pictures: PictureProcesses


@dataclass(frozen=True, slots=True)
class SceneParts:
    """What scenes are, and what happens in them."""

    reads: SceneReads
    news: SceneNews


@dataclass(frozen=True, slots=True)
class WebhookParts:
    """Where events are sent, those that wait, and who sends them."""

    store: WebhookStore
    outbox: Outbox
    deliveries: Deliveries


@dataclass(frozen=True, slots=True)
class RecordParts:
    """Who changed what, and the deletion of what tenants have."""

    audit: AuditLog
    data: TenantData


@dataclass(frozen=True, slots=True)
class UpkeepParts:
    """What looks after the store's files, the database, its disk and its backups."""

    scrub: Scrub
    snapshots: Snapshots
    reserve: DiskReserve
    backups: BackupRecords


@dataclass(frozen=True, slots=True)
class Gateway:
    """All parts of a running gateway.

    settings   with the data folder that this gateway works in
    parts      (tenant, collection) -> how its shards and nodes are read, cached
    search     finds rows in collections
    """

    settings: GatewaySettings
    store: Store
    keys: Keys
    parts: Callable[[str, str], TreeParts]
    search: SearchIndexes
    metrics: Metrics
    workers: WorkerPool
    job_store: AsyncJobStore
    dispatcher: Dispatcher
    downloads: Downloads
    access: AccessParts
    captures: CaptureParts
    scenes: SceneParts
    webhooks: WebhookParts
    records: RecordParts
    upkeep: UpkeepParts


def keep_gateway(app: FastAPI, gateway: Gateway) -> None:
    """Give an app that starts its gateway."""
    app.state.gateway = gateway


def gateway_in(app: FastAPI) -> Gateway:
    """Return the gateway of an app that has been started."""
    gateway: Gateway = app.state.gateway
    return gateway


def gateway_of(request: Request) -> Gateway:
    """Return the gateway that answers a request."""
    return gateway_in(request.app)


async def _gateway_of(request: Request) -> Gateway:
    return gateway_of(request)  # a coroutine: the framework would call a plain function on a thread


GatewayOf = Annotated[Gateway, Depends(_gateway_of)]
"""The parameter `gateway` of a route."""
