"""/v1/deletions, /v1/retention, /v1/export, /v1/audit: data in the hands of those whose they are."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import StreamingResponse
from pydantic import BaseModel, Field

from capture2vr.gateway.access.caller import Caller, Scope
from capture2vr.gateway.errors import Problem
from capture2vr.gateway.gateway import Gateway, GatewayOf
from capture2vr.gateway.records.audit_log import AuditRecord
from capture2vr.gateway.records.deletions import Deletion
from capture2vr.gateway.records.export import export_blocks
from capture2vr.gateway.records.tenant_data import Retention
from capture2vr.gateway.routes.access_rules import caller_of, needs
from capture2vr.gateway.routes.assets import Key, check_key
from capture2vr.gateway.routes.read_rules import unknown_asset
from capture2vr.gateway.routes.store_access import in_thread, store_of, store_problems
from capture2vr.gateway.schemas import StrictBody, TenantName, problems
from capture2vr.sentences.sentence import say
from capture2vr.storage.tenant_store import TENANT_PATTERN

router = APIRouter(prefix="/v1", tags=["data"])

_MOST_DAYS = 36_500
_PRIVATE = {"Cache-Control": "private, no-store"}

Days = Annotated[int, Field(strict=True, ge=0, le=_MOST_DAYS)]
Whose = Annotated[
    str, Query(pattern=rf"^(\*|{TENANT_PATTERN})?$", description="Whose, for operators; * for all; empty: own.")
]


class DeletionView(BaseModel):
    """The receipt of a deletion: the objects that went, and the URLs that a CDN in front must purge.

    `jobs` are the ids of deleted jobs; `kept` names objects that stay, which hold nothing of the data.
    """

    id: str
    tenant: str
    at: datetime
    what: str
    bytes: int
    objects: list[str]
    purge: list[str]
    jobs: list[str]
    kept: list[str]

    @classmethod
    def of(cls, found: Deletion) -> DeletionView:
        """Convert a receipt."""
        at = datetime.fromtimestamp(found.at, UTC)
        return cls(id=found.id, tenant=found.tenant, at=at, **{"jobs": [], "kept": [], **found.receipt})


class DeletionPage(BaseModel):
    """A page of receipts, oldest first. `next` is the value of `after` for the next page; null on the last page."""

    deletions: list[DeletionView]
    next: str | None


class EverythingRequest(StrictBody):
    """Delete everything: the name of the caller's own tenant, so that no mistyped request does it."""

    tenant: TenantName


class RetentionView(BaseModel):
    """After how many days what is deleted; 0: never. Captures count from their upload, removed assets from their
    removal, jobs from their end. `jobs_days` is the service's, as long as the tenant has set none.
    """

    captures_days: int
    removed_assets_days: int
    jobs_days: int

    @classmethod
    def of(cls, days: Mapping[str, int], gateway: Gateway) -> RetentionView:
        """Return what holds for a tenant that has set these days."""
        found = Retention.of(days, gateway.settings.jobs_days)
        return cls(**{name: getattr(found, name) for name in cls.model_fields})


class RetentionRequest(StrictBody):
    """After how many days what is deleted; 0: never. Without `jobs_days` the service's own number holds."""

    captures_days: Days = 0
    removed_assets_days: Days = 0
    jobs_days: Days | None = None


class AuditView(BaseModel):
    """One request that changed something, or tried to: who (key of a tenant), from where, what, and the answer."""

    id: int
    at: datetime
    tenant: str
    via: str
    key: str
    address: str
    request: str
    method: str
    path: str
    status: int

    @classmethod
    def of(cls, found: AuditRecord) -> AuditView:
        """Convert a row."""
        fields = {name: getattr(found, name) for name in found.__slots__}
        return cls(**{**fields, "at": datetime.fromtimestamp(found.at, UTC)})


class AuditPage(BaseModel):
    """A page of the audit log, newest first. `next` is the value of `before` for the next page; null on the last."""

    records: list[AuditView]
    next: int | None


@router.delete(
    "/assets/{key}",
    response_model=DeletionView,
    dependencies=[needs(Scope.MANAGE)],
    responses=problems(404, 409, 422, 503),
)
async def delete_asset(key: Key, request: Request, gateway: GatewayOf) -> DeletionView:
    """Delete an asset for good, with all its versions, from every collection. Removing only hides it."""
    check_key(key)
    data = gateway.records.data
    try:
        with store_problems():
            return DeletionView.of(await data.delete_asset(caller_of(request).tenant, key))
    except FileNotFoundError:
        raise unknown_asset(key) from None


@router.post(
    "/deletions",
    status_code=201,
    response_model=DeletionView,
    dependencies=[needs(Scope.MANAGE)],
    responses=problems(409, 415, 422, 503),
)
async def delete_everything(body: EverythingRequest, request: Request, gateway: GatewayOf) -> DeletionView:
    """Delete everything that the tenant has: captures, assets, collections and jobs. Export it first, if it is wanted.

    Keys, webhooks, receipts and the audit log stay.
    """
    tenant = caller_of(request).tenant
    if body.tenant != tenant:
        detail = f"this key is one of the tenant {tenant}, not of {body.tenant}"
        raise Problem(422, "TENANT_MISMATCH", detail, hints=(say("name_tenant_whose_data_shall"),))
    with store_problems():
        return DeletionView.of(await gateway.records.data.delete_everything(tenant))


@router.get("/deletions", response_model=DeletionPage, dependencies=[needs(Scope.MANAGE, Scope.OPERATE)])
async def list_deletions(
    request: Request,
    gateway: GatewayOf,
    tenant: Whose = "",
    limit: Annotated[int, Query(ge=1, le=100)] = 20,
    after: Annotated[str, Query(pattern=r"^(del_[0-9a-f]{1,60})?$", description="`next` of the previous page.")] = "",
) -> DeletionPage:
    """List receipts of deletions, oldest first: what a CDN's purge job reads."""
    whose, deletions = _whose(caller_of(request), tenant), gateway.records.data.deletions
    found = await gateway.access.authentication.run(lambda: deletions.page(whose, after=after, limit=limit + 1))
    views = [DeletionView.of(each) for each in found[:limit]]
    return DeletionPage(deletions=views, next=views[-1].id if len(found) > limit else None)


@router.get("/retention", response_model=RetentionView, dependencies=[needs(Scope.MANAGE)])
async def get_retention(request: Request, gateway: GatewayOf) -> RetentionView:
    """Get after how many days what of the tenant is deleted."""
    authentication, tenant = gateway.access.authentication, caller_of(request).tenant
    days = await authentication.run(lambda: authentication.store.retention(tenant))
    return RetentionView.of(days, gateway)


@router.put(
    "/retention", response_model=RetentionView, dependencies=[needs(Scope.MANAGE)], responses=problems(415, 422)
)
async def set_retention(body: RetentionRequest, request: Request, gateway: GatewayOf) -> RetentionView:
    """Set after how many days what of the tenant is deleted. The first deletion may follow within an hour."""
    authentication, tenant = gateway.access.authentication, caller_of(request).tenant
    days = body.model_dump(exclude_none=True, exclude_defaults=True)
    await authentication.run(lambda: authentication.store.set_retention(tenant, days))
    return RetentionView.of(days, gateway)


@router.get(
    "/export",
    response_class=Response,
    dependencies=[needs(Scope.MANAGE)],
    responses={200: {"content": {"application/zip": {}}}, **problems(503)},
)
async def export(request: Request, gateway: GatewayOf) -> StreamingResponse:
    """Download everything that the tenant has in one zip: captures, assets in all versions, collections, jobs."""
    tenant, store = caller_of(request).tenant, store_of(request)
    await in_thread(lambda: store.list("", limit=1))  # a store that does not answer is told before the download begins
    jobs = gateway.job_store.blocking
    blocks = export_blocks(store, lambda after, limit: jobs.page(tenant, limit=limit, after=after))
    headers = {"Content-Disposition": f'attachment; filename="capture2vr-{tenant}.zip"', **_PRIVATE}
    return StreamingResponse(blocks, headers=headers, media_type="application/zip")


@router.get("/audit", response_model=AuditPage, dependencies=[needs(Scope.MANAGE, Scope.OPERATE)])
async def get_audit_log(
    request: Request,
    gateway: GatewayOf,
    tenant: Whose = "",
    limit: Annotated[int, Query(ge=1, le=200)] = 50,
    before: Annotated[int, Query(ge=0, lt=1 << 62, description="`next` of the previous page; 0: the newest.")] = 0,
) -> AuditPage:
    """Read the audit log, newest first: who changed what, from which address and when."""
    whose, store = _whose(caller_of(request), tenant), gateway.records.audit.store
    found = await gateway.access.authentication.run(lambda: store.page(tenant=whose, before=before, limit=limit + 1))
    views = [AuditView.of(each) for each in found[:limit]]
    return AuditPage(records=views, next=views[-1].id if len(found) > limit else None)


def _whose(caller: Caller, tenant: str) -> str | None:
    """Return the tenant whose records a caller may read; None: of all. Raises Problem for another's."""
    if Scope.OPERATE in caller.scopes:
        return None if tenant == "*" else tenant or caller.tenant
    if tenant in ("", caller.tenant):
        return caller.tenant
    detail = "the records of other tenants are for callers with the scope operate"
    raise Problem(403, "SCOPE_MISSING", detail, hints=("leave `tenant` out",))
