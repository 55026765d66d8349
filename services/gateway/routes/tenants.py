"""/v1/tenants, /v1/usage: tenants, their limits, and what they use."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated

from fastapi import APIRouter, Path, Query, Request
from pydantic import BaseModel, Field

from capture2vr.gateway.access.authentication import Authentication
from capture2vr.gateway.access.caller import Scope
from capture2vr.gateway.access.limits import TenantLimits
from capture2vr.gateway.access.store import Tenant
from capture2vr.gateway.errors import Problem
from capture2vr.gateway.gateway import Gateway, GatewayOf
from capture2vr.gateway.jobs.store import JobStore
from capture2vr.gateway.routes.access_rules import caller_of, limits_of, needs
from capture2vr.gateway.schemas import Label, StrictBody, TenantName, problems
from capture2vr.sentences.sentence import say
from capture2vr.storage.tenant_store import TENANT_PATTERN

router = APIRouter(prefix="/v1", tags=["access"])

_MOST = 1 << 60  # of any limit: what a database's integer holds

Name = Annotated[str, Path(max_length=32, pattern=f"^{TENANT_PATTERN}$", description="Name of a tenant.")]
PresetName = Annotated[str, Field(min_length=1, max_length=100)]
Count = Annotated[int, Field(strict=True, ge=0, le=_MOST)]


class TenantRequest(StrictBody):
    """A new tenant: its name, which is part of its keys, and a name for people."""

    name: TenantName
    label: Label = ""


class TenantView(BaseModel):
    """A tenant."""

    name: str
    label: str
    created: datetime

    @classmethod
    def of(cls, tenant: Tenant) -> TenantView:
        """Convert a tenant."""
        return cls(name=tenant.name, label=tenant.label, created=_utc(tenant.created))


class TenantPage(BaseModel):
    """A page of tenants, by name. `next` is the value of `after` for the next page; null on the last page."""

    tenants: list[TenantView]
    next: str | None


class LimitsView(BaseModel):
    """Limits of a tenant; 0 is no limit. `jobs_at_once` counts jobs that have not ended; `job_seconds` is what one may
    compute, `processor_s_per_minute` is for the checks and inspections of uploads. `presets` are those that jobs may
    name; none: all but the methods from the literature. Operators' jobs may name all, and compute as long as a worker
    lets them.
    """

    requests_per_minute: int
    uploads_at_once: int
    jobs_at_once: int
    jobs_per_day: int
    stored_bytes: int
    capture_bytes: int
    job_seconds: int
    processor_s_per_minute: int
    presets: list[str]


class LimitsRequest(StrictBody):
    """Limits of one tenant in place of the gateway's; null leaves the gateway's, 0 is no limit."""

    requests_per_minute: Count | None = None
    uploads_at_once: Count | None = None
    jobs_at_once: Count | None = None
    jobs_per_day: Count | None = None
    stored_bytes: Count | None = None
    capture_bytes: Count | None = None
    job_seconds: Count | None = None
    processor_s_per_minute: Count | None = None
    presets: Annotated[list[PresetName], Field(max_length=100)] | None = None


class UsageView(BaseModel):
    """What a tenant uses, beside its limits. `jobs` have not ended; `stored_bytes` is right to within ten minutes.

    `own_limits` has those of `limits` that were set for this tenant alone.
    """

    tenant: str
    limits: LimitsView
    own_limits: dict[str, int | list[str]]
    jobs: int
    jobs_today: int
    stored_bytes: int


@router.post(
    "/tenants",
    status_code=201,
    response_model=TenantView,
    dependencies=[needs(Scope.OPERATE)],
    responses=problems(409, 415, 422),
)
async def create_tenant(body: TenantRequest, gateway: GatewayOf) -> TenantView:
    """Create a tenant. Its captures, jobs, assets and collections are its own."""
    authentication = gateway.access.authentication
    store = authentication.store
    if not await authentication.run(lambda: store.ensure_tenant(body.name, body.label)):
        raise Problem(
            409, "TENANT_EXISTS", say("tenant_already", tenant=body.name), hints=(say("choose_another_name"),)
        )
    created = await authentication.run(lambda: store.tenant(body.name))
    assert created is not None
    return TenantView.of(created)


@router.get("/tenants", response_model=TenantPage, dependencies=[needs(Scope.OPERATE)], responses=problems(422))
async def list_tenants(
    gateway: GatewayOf,
    limit: Annotated[int, Query(ge=1, le=200)] = 50,
    after: Annotated[str, Query(pattern=f"^({TENANT_PATTERN})?$", description="`next` of the previous page.")] = "",
) -> TenantPage:
    """List tenants by name."""
    authentication = gateway.access.authentication
    found = await authentication.run(lambda: authentication.store.list_tenants(limit=limit + 1, after=after))
    tenants = [TenantView.of(each) for each in found[:limit]]
    return TenantPage(tenants=tenants, next=tenants[-1].name if len(found) > limit else None)


@router.put(
    "/tenants/{name}/limits",
    response_model=LimitsView,
    dependencies=[needs(Scope.OPERATE)],
    responses=problems(404, 415, 422),
)
async def set_limits(name: Name, body: LimitsRequest, gateway: GatewayOf) -> LimitsView:
    """Set the limits of one tenant, in place of those it had. Other gateways take them up within seconds."""
    authentication = gateway.access.authentication
    await _require_tenant(name, authentication)
    own = body.model_dump(exclude_none=True)
    await authentication.run(lambda: authentication.store.set_limits(name, own))
    gateway.access.limits.forget(name)
    return LimitsView(**(await gateway.access.limits.of(name)).document())


@router.get(
    "/tenants/{name}/usage",
    response_model=UsageView,
    dependencies=[needs(Scope.OPERATE)],
    responses=problems(404, 422, 503),
)
async def get_tenant_usage(name: Name, gateway: GatewayOf) -> UsageView:
    """Get a tenant's limits, and what it uses."""
    await _require_tenant(name, gateway.access.authentication)
    return await _usage(name, await gateway.access.limits.of(name), gateway)


@router.get("/usage", response_model=UsageView, dependencies=[needs(*Scope)], responses=problems(503))
async def get_usage(request: Request, gateway: GatewayOf) -> UsageView:
    """Get the limits of the caller's own tenant, and what it uses."""
    return await _usage(caller_of(request).tenant, await limits_of(request), gateway)


async def _usage(tenant: str, limits: TenantLimits, gateway: Gateway) -> UsageView:
    stored = await gateway.access.usage.stored_bytes(tenant)
    active, today = await gateway.job_store.read(JobStore.load, tenant)
    authentication = gateway.access.authentication
    own = await authentication.run(lambda: authentication.store.own_limits(tenant))
    return UsageView(
        tenant=tenant,
        limits=LimitsView(**limits.document()),
        own_limits=own or {},
        jobs=active,
        jobs_today=today,
        stored_bytes=stored,
    )


async def _require_tenant(name: str, authentication: Authentication) -> None:
    """Raises Problem TENANT_UNKNOWN."""
    if await authentication.run(lambda: authentication.store.tenant(name)) is None:
        raise Problem(404, "TENANT_UNKNOWN", say("no_tenant", tenant=name), hints=("GET /v1/tenants lists them",))


def _utc(seconds: float) -> datetime:
    return datetime.fromtimestamp(seconds, UTC)
