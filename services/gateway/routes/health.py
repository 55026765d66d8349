"""/livez, /readyz and /metrics: health checks and Prometheus metrics for operators."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request, Response
from prometheus_client import CONTENT_TYPE_LATEST
from sqlalchemy.exc import SQLAlchemyError

from capture2vr.gateway.access.caller import Scope
from capture2vr.gateway.gateway import Gateway, GatewayOf
from capture2vr.gateway.jobs.async_store import AsyncJobStore
from capture2vr.gateway.jobs.job_counts import QueueFigures
from capture2vr.gateway.jobs.store import JobStore
from capture2vr.gateway.routes.access_rules import ANYONE, SCRAPERS, authenticate
from capture2vr.gateway.schemas import Readiness, problems
from capture2vr.gateway.vitals.checks import run_checks

router = APIRouter(tags=["health"])

_QUEUE_S = 2.0  # after which the metrics are shown without the queue's
ExcludeQuery = Annotated[Sequence[Literal["store", "database", "disk", "workers"]], Query()]


@router.get("/livez", response_class=Response, dependencies=[ANYONE], responses={200: {"content": {"text/plain": {}}}})
async def livez() -> Response:
    """Liveness check: answers "ok" as long as the process is alive."""
    return Response("ok\n", media_type="text/plain")


@router.get(
    "/readyz", response_model=Readiness, dependencies=[ANYONE], responses={503: {"model": Readiness}, **problems(401)}
)
async def readyz(request: Request, gateway: GatewayOf, response: Response, exclude: ExcludeQuery = ()) -> Readiness:
    """Readiness check: 200 if jobs can run, else 503. `exclude` leaves checks out: without a worker, captures are still
    taken and jobs wait.

    The store, the database, for writing too, and at least one worker must answer, and the disks have space. What each
    of them said is for operators; orchestrators, which have no key, get the status alone.
    """
    may_see = await _may_see_checks(request, gateway)
    checks = await run_checks(gateway)
    ready = all(check.ok for name, check in checks.items() if name not in exclude)
    response.status_code = 200 if ready else 503
    return Readiness(ready=ready, checks=checks if may_see else {})


@router.get(
    "/metrics",
    response_class=Response,
    dependencies=[SCRAPERS],
    responses={200: {"content": {"text/plain": {}}}},
)
async def get_metrics(gateway: GatewayOf) -> Response:
    """Get metrics in Prometheus' text format. Nothing is counted for it, and no other service is asked."""
    metrics, scrub = gateway.metrics, gateway.upkeep.scrub.state
    metrics.show_scrub(len(scrub.damaged), scrub.ended)
    metrics.jobs.show_queue(await _figures(gateway.job_store))
    streams = gateway.job_store.notifier.listener_count + gateway.scenes.news.listener_count
    return Response(metrics.render(streams), headers={"Content-Type": CONTENT_TYPE_LATEST})


async def _figures(job_store: AsyncJobStore) -> QueueFigures | None:
    """Return the figures of the queue; None while the database is away: the other metrics are shown all the same."""
    try:
        async with asyncio.timeout(_QUEUE_S):
            return await job_store.read(JobStore.figures)
    except (SQLAlchemyError, TimeoutError):
        return None


async def _may_see_checks(request: Request, gateway: Gateway) -> bool:
    try:
        return Scope.OPERATE in (await authenticate(request)).scopes
    except SQLAlchemyError:  # the keys are in the database, which is one of the checks
        return not gateway.settings.is_public
