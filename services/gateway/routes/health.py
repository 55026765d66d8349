"""/livez, /readyz and /metrics: health checks and Prometheus metrics for operators."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import Awaitable, Sequence
from pathlib import Path
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request, Response
from prometheus_client import CONTENT_TYPE_LATEST
from sqlalchemy.exc import SQLAlchemyError

from capture2vr.gateway.access.caller import Scope
from capture2vr.gateway.backup.scrub import ScrubState
from capture2vr.gateway.backup.snapshots import Snapshots
from capture2vr.gateway.database_faults import Fault, fault_of
from capture2vr.gateway.gateway import Gateway, GatewayOf
from capture2vr.gateway.jobs.async_store import AsyncJobStore
from capture2vr.gateway.jobs.store import JobStore
from capture2vr.gateway.routes.access_rules import ANYONE, authenticate, needs
from capture2vr.gateway.schemas import Check, Readiness, problems
from capture2vr.gateway.workers.worker_client import WorkerPool
from capture2vr.storage.local import LocalStore
from capture2vr.storage.store import Store

router = APIRouter(tags=["health"])

_LEAST_FREE = 64 << 20  # bytes: below it the database's log and a small upload may no longer fit
ExcludeQuery = Annotated[Sequence[Literal["store", "database", "disk", "workers"]], Query()]
_CHECK_S = 2.0  # timeout of one check: orchestrators ask every few seconds and wait about as long


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


async def run_checks(gateway: Gateway) -> dict[str, Check]:
    """Check the store, the database, the disks and the workers, all at once, each for 2 s at most."""
    names = ("store", "database", "disk", "workers")
    found = await asyncio.gather(
        _store(gateway.store, gateway.upkeep.scrub.state),
        _database(gateway.job_store, gateway.upkeep.snapshots),
        asyncio.to_thread(_disk, [gateway.settings.data_dir, *_folders(gateway.store)]),
        _workers(gateway.workers),
    )
    return dict(zip(names, found, strict=True))


@router.get(
    "/metrics",
    response_class=Response,
    dependencies=[needs(Scope.OPERATE)],
    responses={200: {"content": {"text/plain": {}}}},
)
async def metrics(gateway: GatewayOf) -> Response:
    """Get metrics in Prometheus' text format."""
    job_store = gateway.job_store
    scrub = gateway.upkeep.scrub.state
    gateway.metrics.show_scrub(len(scrub.damaged), scrub.ended)
    streams = job_store.notifier.listener_count + gateway.scenes.news.listener_count
    page = gateway.metrics.render(await job_store.read(JobStore.count_by_state), streams)
    return Response(page, headers={"Content-Type": CONTENT_TYPE_LATEST})


async def _may_see_checks(request: Request, gateway: Gateway) -> bool:
    try:
        return Scope.OPERATE in (await authenticate(request)).scopes
    except SQLAlchemyError:  # the keys are in the database, which is one of the checks
        return not gateway.settings.is_public


async def _check(question: Awaitable[object]) -> Check:
    try:
        async with asyncio.timeout(_CHECK_S):
            await question
    except TimeoutError:
        return Check(ok=False, detail=f"no answer within {_CHECK_S:g} s")
    except SQLAlchemyError as error:
        return Check(ok=False, detail=fault_of(error).value)
    except Exception as error:  # noqa: BLE001 - whatever it is, the gateway is not ready; its type is reported
        return Check(ok=False, detail=type(error).__name__)
    return Check(ok=True, detail="answers")


async def _store(store: Store, scrub: ScrubState) -> Check:
    """Damaged files are told, but jobs can run with them, so the store is ready."""
    found = await _check(asyncio.to_thread(store.list, "catalog/", limit=1))
    if not found.ok or not scrub.damaged:
        return found
    detail = f"{found.detail}; {len(scrub.damaged)} files are damaged, the first is {scrub.damaged[0]}"
    return Check(ok=True, detail=detail)


async def _database(job_store: AsyncJobStore, snapshots: Snapshots) -> Check:
    if snapshots.fault:
        return Check(ok=False, detail=f"damaged: {snapshots.fault}")
    if job_store.is_full:
        return Check(ok=False, detail=Fault.FULL.value)
    return await _check(job_store.read(JobStore.check_writable))


def _folders(store: Store) -> list[Path]:
    return [store.root] if isinstance(store, LocalStore) else []


def _disk(folders: list[Path]) -> Check:
    free = min(shutil.disk_usage(folder).free for folder in folders)
    return Check(ok=free >= _LEAST_FREE, detail=f"{free / 1e9:.1f} GB are free")


async def _workers(workers: WorkerPool) -> Check:
    found = await workers.poll()
    usable = [worker for worker in found if worker.is_compatible]
    free = sum(worker.free_slots for worker in usable if not worker.draining)
    details = [f"{len(found)} of {len(workers.addresses)} workers answer", f"{free} slots are free"]
    details += [f"{worker.address} is of version {worker.version}" for worker in found if not worker.is_compatible]
    details += [f"{name} resolves to no address" for name in workers.unresolved]
    return Check(ok=bool(usable), detail=", ".join(details))
