"""/v1/service: what an operator wants to know of the whole service, at one look."""

from __future__ import annotations

import asyncio
from dataclasses import asdict
from datetime import UTC, datetime

from fastapi import APIRouter
from pydantic import BaseModel

import capture2vr
from capture2vr.gateway.access.caller import Scope
from capture2vr.gateway.database.disks import disks_of
from capture2vr.gateway.gateway import GatewayOf
from capture2vr.gateway.jobs.job import Job, State
from capture2vr.gateway.jobs.state_machine import RUNNING_STATES
from capture2vr.gateway.jobs.store import JobStore
from capture2vr.gateway.routes.access_rules import needs
from capture2vr.gateway.schemas import Check
from capture2vr.gateway.vitals.checks import run_checks
from capture2vr.gateway.workers.worker_client import WorkerPool
from capture2vr.gateway.workers.worker_types import WorkerStatus

router = APIRouter(prefix="/v1", tags=["access"])

_FAILURES = 20


class WorkerView(BaseModel):
    """A worker that answers. `device` is where it trains, `slots` how many jobs it runs at once, `memory_bytes` what
    they may take together. One of another release series than the gateway's is not `compatible`, and gets no jobs.
    """

    address: str
    version: str
    device: str
    presets: list[str]
    slots: int
    free_slots: int
    queued: int
    draining: bool
    memory_bytes: int
    compatible: bool


class DiskView(BaseModel):
    """A disk of this gateway. `holds`: database and staging, or the objects of a local store."""

    holds: str
    free_bytes: int
    total_bytes: int


class FailureView(BaseModel):
    """A job that failed, whose, and why."""

    job: str
    tenant: str
    asset_key: str
    at: datetime
    code: str
    detail: str


class ServiceView(BaseModel):
    """State of the service. `open`: nobody is asked for a key. `checks` are those of /readyz. `jobs` counts all jobs by
    state; `waiting_s`: for how long the oldest queued job has waited, 0 where none does.
    """

    version: str
    open: bool
    ready: bool
    checks: dict[str, Check]
    jobs: dict[State, int]
    waiting_s: float
    workers: list[WorkerView]
    silent_workers: list[str]
    disks: list[DiskView]
    failures: list[FailureView]


class QueueView(BaseModel):
    """Number of jobs that wait, that run, and of both together; `waiting_s`: for how long the oldest has waited."""

    queued: int
    running: int
    unfinished: int
    waiting_s: float


@router.get("/queue", response_model=QueueView, dependencies=[needs(Scope.OPERATE)])
async def get_queue(gateway: GatewayOf) -> QueueView:
    """Get the length of the queue, by which an autoscaler adds and removes workers: nothing is counted for it."""
    figures = await gateway.job_store.read(JobStore.figures)
    queued, running = figures.counts[State.QUEUED], sum(figures.counts[state] for state in RUNNING_STATES)
    return QueueView(queued=queued, running=running, unfinished=queued + running, waiting_s=figures.waiting_s)


@router.get("/service", response_model=ServiceView, dependencies=[needs(Scope.OPERATE)])
async def get_service(gateway: GatewayOf) -> ServiceView:
    """Get the state of queue, workers, stores and disks, and the jobs that failed last."""
    jobs, pool = gateway.job_store, gateway.workers
    checks, workers, figures, failures, disks = await asyncio.gather(
        run_checks(gateway),
        pool.poll(),
        jobs.read(JobStore.figures),
        jobs.read(JobStore.failures, limit=_FAILURES),
        asyncio.to_thread(disks_of, gateway.settings.data_dir, gateway.store),
    )
    return ServiceView(
        version=capture2vr.__version__,
        open=await gateway.access.authentication.is_open(),
        ready=all(check.ok for check in checks.values()),
        checks=checks,
        jobs=dict(figures.counts),
        waiting_s=figures.waiting_s,
        workers=[_worker_view(each) for each in workers],
        silent_workers=_silent(pool, workers),
        disks=[DiskView(**asdict(disk)) for disk in disks],
        failures=[_failure_view(job) for job in failures],
    )


def _worker_view(found: WorkerStatus) -> WorkerView:
    names = ("address", "version", "device", "slots", "free_slots", "queued", "draining", "memory_bytes")
    presets = [preset.name for preset in found.presets]
    return WorkerView(presets=presets, compatible=found.is_compatible, **{name: getattr(found, name) for name in names})


def _silent(pool: WorkerPool, answering: tuple[WorkerStatus, ...]) -> list[str]:
    known = {each.address for each in answering}
    return [address for address in pool.addresses if address not in known]


def _failure_view(job: Job) -> FailureView:
    error = job.error or {}
    return FailureView(
        job=job.id,
        tenant=job.tenant,
        asset_key=job.order.asset_key,
        at=datetime.fromtimestamp(job.updated, UTC),
        code=str(error.get("code", "")),
        detail=str(error.get("detail", "")),
    )
