"""Have workers make downloads of assets: each once, however many ask for it, and to its end, even if they hang up."""

from __future__ import annotations

import asyncio
import hashlib
import logging

from capture2vr.gateway.errors import RETRY_S, Problem
from capture2vr.gateway.workers.worker_client import WorkerPool
from capture2vr.gateway.workers.worker_types import RunUnknown, WorkerBusy, WorkerLost
from capture2vr.sentences.sentence import say
from capture2vr.storage.catalogue.downloads import DownloadOrder, StoredDownload, find_download
from capture2vr.storage.store import Store
from capture2vr.storage.tenant_store import store_of_tenant, tenant_prefix

WAIT_S = 20.0
"""Longest that a request waits for a download to be made: proxies end requests after 30 s or more."""
MOST = 64
"""Most downloads that this gateway has made at once: the workers' lines are as long together."""

_log = logging.getLogger(__name__)


class Downloads:
    """Finds downloads on the store, and has workers make those that are not there. Used on the event loop."""

    def __init__(self, workers: WorkerPool, store: Store) -> None:
        self._workers = workers
        self._store = store
        self._making: dict[str, asyncio.Task[StoredDownload]] = {}

    async def get(self, tenant: str, order: DownloadOrder) -> StoredDownload | None:
        """Return a download of a tenant's asset, or None where it is still being made after WAIT_S: ask again.

        Raises OSError, and Problem where it cannot be made, or not now.
        """
        store = store_of_tenant(self._store, tenant)
        if found := await asyncio.to_thread(find_download, store, order):
            return found
        name = tenant_prefix(tenant) + order.record_name
        task = self._making.get(name)
        if task is None:
            if len(self._making) >= MOST:
                raise _not_now(say("too_many_downloads_being_made"))
            task = self._making[name] = asyncio.create_task(self._make(tenant, order))
            task.add_done_callback(lambda done: self._forget(name, done))
        # Not cancelled with this request: others may wait for it, and whoever asks again finds it.
        await asyncio.wait({task}, timeout=WAIT_S)
        return task.result() if task.done() else None

    async def close(self) -> None:
        """Stop waiting for workers, which go on."""
        tasks = list(self._making.values())
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _make(self, tenant: str, order: DownloadOrder) -> StoredDownload:
        """Ask the workers by turns. Raises Problem.

        All gateways ask the same worker first, which makes what two want at a time only once.
        """
        statuses = [status for status in await self._workers.poll() if status.takes_jobs]
        addresses = sorted((each.address for each in statuses), key=lambda address: _rank(address, order))
        for address in addresses:
            try:
                return await self._workers.make_download(address, tenant, order)
            except (WorkerBusy, WorkerLost, RunUnknown) as error:
                _log.warning("worker %s did not make %s of asset %s: %s", address, order.format.name, order.key, error)
        raise _not_now(say("no_worker_free_to_make") if addresses else say("no_worker_to_make_file"))

    def _forget(self, name: str, task: asyncio.Task[StoredDownload]) -> None:
        del self._making[name]
        if not task.cancelled() and (error := task.exception()):  # those who waited get it too
            _log.info("download %s was not made: %s", name, error)


def _rank(address: str, order: DownloadOrder) -> bytes:
    """Order of a worker for a download: another one for each (rendezvous hashing)."""
    return hashlib.sha256(f"{address} {order.record_name}".encode()).digest()


def _not_now(detail: str) -> Problem:
    return Problem(503, "DOWNLOAD_NOT_NOW", detail, retryable=True, headers={"Retry-After": str(RETRY_S)})
