"""Delete what a tenant has: one asset, captures, everything; and what it wants to be kept no longer than some days.

Each deletion that was asked for leaves a receipt, and tells the tenant's webhooks. Runs on the event loop.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from typing import Any, TypeVar

from sqlalchemy.exc import SQLAlchemyError

from capture2vr.gateway.access.authentication import Authentication
from capture2vr.gateway.access.readers import Thing
from capture2vr.gateway.access.shares import ShareStore
from capture2vr.gateway.access.usage import Usage
from capture2vr.gateway.errors import Problem
from capture2vr.gateway.jobs.async_store import AsyncJobStore
from capture2vr.gateway.jobs.capture_objects import delete_capture, list_captures
from capture2vr.gateway.jobs.store import JobStore
from capture2vr.gateway.records.deletions import Deletion, DeletionStore, receipt_of
from capture2vr.gateway.resumable.store import UploadStore
from capture2vr.gateway.search.indexes import SearchIndexes
from capture2vr.gateway.webhooks.deliveries import Deliveries
from capture2vr.gateway.webhooks.outbox import Outbox, WebhookEvent
from capture2vr.sentences.sentence import say
from capture2vr.storage.catalogue.deletion import DeletedObject, delete_asset, delete_everything
from capture2vr.storage.catalogue.entry import list_keys, read_entry
from capture2vr.storage.catalogue.signing import Keys
from capture2vr.storage.store import Store
from capture2vr.storage.tenant_store import store_of_tenant

DAY_S = 86_400.0
PROGRESS_S = 3_600.0
"""Seconds after a job's end for which its events of progress are kept: for who was cut off, and comes back."""
_PERIOD_S = 3_600.0  # between two looks for what has been kept long enough; days are what people count in
_PAGE = 100

_T = TypeVar("_T")

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Retention:
    """After how many days what of a tenant is deleted; 0: never.

    captures_days        since the upload
    removed_assets_days  since the asset was removed (hidden)
    jobs_days            since the job ended; is_own: whether the tenant has said how many, and not the service
    """

    captures_days: int = 0
    removed_assets_days: int = 0
    jobs_days: int = 0
    is_own: bool = False

    @classmethod
    def of(cls, days: Mapping[str, int], jobs_days: int) -> Retention:
        """Return what holds for a tenant that has set these days. jobs_days: the service's own"""
        return cls(
            captures_days=days.get("captures_days", 0),
            removed_assets_days=days.get("removed_assets_days", 0),
            jobs_days=days.get("jobs_days", jobs_days),
            is_own="jobs_days" in days,
        )


@dataclass(frozen=True, slots=True)
class TenantData:
    """Deletes tenants' data. Each method may be repeated after a failure, and completes what it began.

    jobs_days  after which jobs that have ended are deleted, of tenants that have set no number; 0: never
    """

    store: Store
    keys: Keys
    authentication: Authentication
    usage: Usage
    job_store: AsyncJobStore
    deletions: DeletionStore
    shares: ShareStore
    outbox: Outbox
    deliveries: Deliveries
    uploads: UploadStore
    search: SearchIndexes
    jobs_days: int

    async def delete_asset(self, tenant: str, key: str) -> Deletion:
        """Delete an asset with all its versions.

        Raises Problem ASSET_IN_USE, FileNotFoundError, ValueError, OSError.
        """
        using = await self.job_store.read(JobStore.unfinished, tenant, asset_key=key)
        if using:
            raise _in_use("ASSET_IN_USE", say("the_asset_key", key=key), using)
        own = store_of_tenant(self.store, tenant)
        await self._run(lambda: self.shares.revoke_all(tenant, Thing(tenant, "asset", key)))
        deleted = await asyncio.to_thread(delete_asset, own, key, self.keys)
        return await self._finish(tenant, "asset.deleted", receipt_of(f"asset {key}", deleted), {"key": key})

    async def delete_everything(self, tenant: str) -> Deletion:
        """Delete a tenant's captures, uploads, assets, collections and ended jobs.

        Keys, webhooks and the audit log stay.

        Raises Problem DATA_IN_USE while a job of the tenant has not ended, OSError.
        """
        if using := await self.job_store.read(JobStore.unfinished, tenant):
            raise _in_use("DATA_IN_USE", "the data", using)
        own = store_of_tenant(self.store, tenant)
        await self._run(lambda: self.uploads.remove_all(tenant, time.time()))
        await self._run(lambda: self.shares.revoke_all(tenant))
        deleted, kept = await asyncio.to_thread(delete_everything, own, self.keys)
        await asyncio.to_thread(self.search.forget, tenant)
        jobs = [job async for some in self._deleted_jobs(tenant, time.time() + DAY_S) for job in some]
        await self.authentication.run(lambda: self.outbox.delete_of(tenant))
        receipt = receipt_of("everything", deleted, jobs=jobs, kept=kept)
        return await self._finish(tenant, "data.deleted", receipt, {"objects": len(deleted), "jobs": len(jobs)})

    async def keep_retention(self) -> None:
        """Delete every hour what is to be kept no longer, until cancelled."""
        while True:
            try:
                await self.apply_retention(time.time())
            except (Problem, OSError, SQLAlchemyError) as error:
                _log.warning("what was kept long enough could not be deleted; trying again later: %s", error)
            await asyncio.sleep(_PERIOD_S)

    async def apply_retention(self, now: float) -> None:
        """Delete what every tenant wants to keep no longer, or the service, and the progress of jobs that have ended.

        What cannot be deleted is logged, and the others go on. Raises SQLAlchemyError.
        """
        while await self.job_store.write(JobStore.delete_progress, before=now - PROGRESS_S):
            pass
        for tenant, days in (await self._run(self.authentication.store.retentions)).items():
            await self._apply(tenant, Retention.of(days, self.jobs_days), now)

    async def _apply(self, tenant: str, retention: Retention, now: float) -> None:
        if retention.captures_days:
            before = now - retention.captures_days * DAY_S
            await self._delete_old("capture", tenant, _old_captures, before, self._delete_capture)
        if retention.removed_assets_days:
            before = now - retention.removed_assets_days * DAY_S
            await self._delete_old("asset", tenant, _old_removed, before, self._delete_removed)
        if retention.jobs_days:
            await self._delete_old_jobs(tenant, now - retention.jobs_days * DAY_S, has_receipts=retention.is_own)

    async def _delete_old_jobs(self, tenant: str, before: float, *, has_receipts: bool) -> None:
        """Delete jobs that ended before a time. has_receipts: not where nobody asked, else they grow in jobs' place"""
        count = 0
        async for jobs in self._deleted_jobs(tenant, before):
            count += len(jobs)
            if has_receipts:
                receipt = receipt_of("ended jobs", [], jobs=jobs)
                await self._run(partial(self.deletions.add, tenant, receipt))
        if count:
            _log.info("%d jobs of %s had ended long enough ago, and are deleted", count, tenant)

    async def _deleted_jobs(self, tenant: str, before: float) -> AsyncIterator[list[str]]:
        """Delete a tenant's jobs that ended before a time, some at a time; yield their ids."""
        while ids := await self.job_store.write(JobStore.delete_ended, tenant, before=before):
            yield ids

    async def _delete_old(
        self,
        kind: str,
        tenant: str,
        find: Callable[[Store, str, float], list[str]],
        before: float,
        delete: Callable[[str, str], Awaitable[None]],
    ) -> None:
        with _failure_logged(f"old {kind}s of {tenant}"):
            for name in await asyncio.to_thread(find, self.store, tenant, before):
                with _failure_logged(f"{kind} {name} of {tenant}"):
                    await delete(tenant, name)

    async def _delete_capture(self, tenant: str, capture: str) -> None:
        if await self.job_store.read(JobStore.unfinished, tenant, capture=capture):
            return  # deleted once the job has ended
        try:
            size = await asyncio.to_thread(delete_capture, store_of_tenant(self.store, tenant), capture)
        except Problem:  # CAPTURE_UNKNOWN: another gateway or a user has deleted it since it was found
            return
        gone = [DeletedObject(f"captures/{capture}", size, "")]
        await self._run(lambda: self.deletions.add(tenant, receipt_of(f"capture {capture}", gone)))
        await self.usage.add(tenant, -size)

    async def _delete_removed(self, tenant: str, key: str) -> None:
        with suppress(FileNotFoundError):  # another gateway or a user has deleted it since it was found
            await self.delete_asset(tenant, key)

    async def _finish(self, tenant: str, event: str, receipt: dict[str, Any], data: dict[str, Any]) -> Deletion:
        deletion = await self._run(lambda: self.deletions.add(tenant, receipt))
        await self.usage.add(tenant, -receipt["bytes"])
        message = WebhookEvent(event, deletion.id, {"deletion": deletion.id, **data})
        await self._run(lambda: self.outbox.enqueue(tenant, message))
        self.deliveries.wake()
        return deletion

    async def _run(self, work: Callable[[], _T]) -> _T:
        return await self.authentication.run(work)


@contextmanager
def _failure_logged(what: str) -> Iterator[None]:
    """Log why something could not be deleted, and go on: the next look tries it again."""
    try:
        yield
    except Problem as problem:
        _log.info("%s: kept for now, because %s", what, problem.detail)
    except (OSError, ValueError) as fault:  # ValueError: a name or a time on the store that is none
        _log.warning("%s: could not be deleted, trying again later: %s", what, fault)


def _old_captures(store: Store, tenant: str, before: float) -> list[str]:
    """Return a tenant's captures that were uploaded before this time; damaged ones have none and stay."""
    own = store_of_tenant(store, tenant)
    found: list[str] = []
    after = ""
    while page := list_captures(own, _capture_and_time, after=after, limit=_PAGE)[0]:
        found += [capture for capture, uploaded in page if uploaded < before]
        after = page[-1][0]
    return found


def _capture_and_time(receipt: dict[str, Any]) -> tuple[str, float]:
    return receipt["capture"], _seconds(str(receipt.get("created")))


def _old_removed(store: Store, tenant: str, before: float) -> list[str]:
    """Return the keys of a tenant's assets that were removed before this time."""
    own = store_of_tenant(store, tenant)
    found: list[str] = []
    after = ""
    while keys := list_keys(own, after=after, limit=_PAGE):
        for key in keys:
            try:
                removed = read_entry(own, key).document.get("removed")
                if removed and _seconds(str(removed)) < before:
                    found.append(key)
            except (OSError, ValueError) as fault:  # damaged, or deleted since the keys were listed
                _log.warning("asset %s of %s: kept, because it cannot be read: %s", key, tenant, fault)
        after = keys[-1]
    return found


def _seconds(iso: str) -> float:
    return datetime.fromisoformat(iso).timestamp()


def _in_use(code: str, what: str, jobs: list[str]) -> Problem:
    detail = say("jobs_may_still_write", what=what, count=len(jobs), names=", ".join(jobs[:3]))
    return Problem(409, code, detail, hints=(say("cancel_wait_end_then_delete"),))
