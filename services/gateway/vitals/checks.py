"""Checks of what a gateway needs to work: the store, the database, space on the disks, a worker."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable

from sqlalchemy.exc import SQLAlchemyError

from capture2vr.gateway.backup.scrub import ScrubState
from capture2vr.gateway.backup.snapshots import Snapshots
from capture2vr.gateway.database.disks import disks_of
from capture2vr.gateway.database_faults import Fault, fault_of
from capture2vr.gateway.gateway import Gateway
from capture2vr.gateway.jobs.async_store import AsyncJobStore
from capture2vr.gateway.jobs.store import JobStore
from capture2vr.gateway.schemas import Check
from capture2vr.gateway.workers.worker_client import WorkerPool
from capture2vr.storage.store import Store

_LEAST_FREE = 64 << 20  # bytes: below it the database's log and a small upload may no longer fit
_CHECK_S = 2.0  # timeout of one check: orchestrators ask every few seconds and wait about as long


async def run_checks(gateway: Gateway) -> dict[str, Check]:
    """Check the store, the database, the disks and the workers, all at once, each for 2 s at most."""
    return {name: check for name, (check, _) in (await timed_checks(gateway)).items()}


async def timed_checks(gateway: Gateway) -> dict[str, tuple[Check, float]]:
    """Check as `run_checks` does; each result comes with the seconds that it took."""
    checks = {
        "store": _store(gateway.store, gateway.upkeep.scrub.state),
        "database": _database(gateway.job_store, gateway.upkeep.snapshots),
        "disk": asyncio.to_thread(_disk, gateway),
        "workers": _workers(gateway.workers),
    }
    return dict(zip(checks, await asyncio.gather(*map(_timed, checks.values())), strict=True))


async def _timed(check: Awaitable[Check]) -> tuple[Check, float]:
    began = time.perf_counter()
    return await check, time.perf_counter() - began


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


def _disk(gateway: Gateway) -> Check:
    free = min(disk.free_bytes for disk in disks_of(gateway.settings.data_dir, gateway.store))
    return Check(ok=free >= _LEAST_FREE, detail=f"{free / 1e9:.1f} GB are free")


async def _workers(workers: WorkerPool) -> Check:
    found = await workers.poll()
    usable = [worker for worker in found if worker.is_compatible]
    free = sum(worker.free_slots for worker in usable if not worker.draining)
    details = [f"{len(found)} of {len(workers.addresses)} workers answer", f"{free} slots are free"]
    details += [f"{worker.address} is of version {worker.version}" for worker in found if not worker.is_compatible]
    details += [f"{name} resolves to no address" for name in workers.unresolved]
    return Check(ok=bool(usable), detail=", ".join(details))
