"""/livez, /readyz and /metrics: for those who run the gateway."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable

from fastapi import APIRouter, Request, Response
from prometheus_client import CONTENT_TYPE_LATEST

from services.gateway.edge import EdgePool
from services.gateway.jobs.store import JobStore
from services.gateway.schemas import Check, Readiness

router = APIRouter(tags=["health"])

_CHECK_S = 2.0  # an orchestrator asks every few seconds and gives up after about as many


@router.get("/livez", response_class=Response, responses={200: {"content": {"text/plain": {}}}})
async def livez() -> Response:
    """Whether the process answers."""
    return Response("ok\n", media_type="text/plain")


@router.get("/readyz", response_model=Readiness, responses={503: {"model": Readiness}})
async def readyz(request: Request, response: Response) -> Readiness:
    """Whether a job would be taken and done: the store, the database and at least one worker answer."""
    state = request.app.state
    names = ("store", "database", "workers")
    found = await asyncio.gather(
        _check(asyncio.to_thread(state.store.list, "catalog/", limit=1)),
        _check(state.desk.read(JobStore.counts)),
        _workers(state.edge),
    )
    checks = dict(zip(names, found, strict=True))
    ready = all(check.ok for check in found)
    response.status_code = 200 if ready else 503
    return Readiness(ready=ready, checks=checks)


@router.get("/metrics", response_class=Response, responses={200: {"content": {"text/plain": {}}}})
async def metrics(request: Request) -> Response:
    """Counters for Prometheus."""
    desk = request.app.state.desk
    page = request.app.state.metrics.page(await desk.read(JobStore.counts), desk.hub.listening)
    return Response(page, headers={"Content-Type": CONTENT_TYPE_LATEST})


async def _check(question: Awaitable[object]) -> Check:
    try:
        async with asyncio.timeout(_CHECK_S):
            await question
    except TimeoutError:
        return Check(ok=False, detail=f"no answer within {_CHECK_S:g} s")
    except Exception as error:  # noqa: BLE001 - whatever it is, the gateway is not ready, and says of which kind
        return Check(ok=False, detail=type(error).__name__)
    return Check(ok=True, detail="answers")


async def _workers(edge: EdgePool) -> Check:

    found = await edge.workers()
    free = sum(worker.free_slots for worker in found if not worker.draining)
    detail = f"{len(found)} of {len(edge.addresses)} workers answer, {free} slots are free"
    return Check(ok=bool(found), detail=detail)
