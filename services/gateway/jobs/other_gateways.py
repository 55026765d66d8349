"""Follows what other gateways on the same database do: by NOTIFY on Postgres, by polling on SQLite."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Mapping

from sqlalchemy.exc import SQLAlchemyError

from capture2vr.gateway.database.postgres_notify import listen
from capture2vr.gateway.jobs.async_store import AsyncJobStore
from capture2vr.gateway.jobs.job import State
from capture2vr.gateway.jobs.job_news import CHANNEL
from capture2vr.gateway.jobs.store import JobStore

_FIRST_REFUSAL_S = 0.1  # the gateway that queued a job mostly finds a slot for it; then the others need not look
_POLL_S = 1.0  # SQLite: between checks for changes that another gateway wrote

_log = logging.getLogger(__name__)


class OtherGateways:
    """Notifies this gateway's listeners of changes that other gateways wrote, and its dispatcher of the queue's.

    wake          called when a job waits that another gateway has queued
    cancel        called with a running job that another gateway was asked to cancel
    channels      on Postgres: what else gateways tell each other, by its channel, and who is called with it
    on_connected  called whenever this gateway begins to hear it: what was told before may be missed
    """

    def __init__(
        self,
        job_store: AsyncJobStore,
        *,
        wake: Callable[[], None],
        cancel: Callable[[str], None],
        channels: Mapping[str, Callable[[str], None]],
        on_connected: Callable[[], None],
    ) -> None:
        self._job_store = job_store
        self._channels = {CHANNEL: self._on_change, **channels}
        self._report_connected = on_connected
        self._wake = wake
        self._cancel = cancel
        self._queued: dict[str, asyncio.TimerHandle] = {}  # jobs that have just been queued, and when to look at them

    async def watch(self) -> None:
        """Listen for other gateways' changes and pass them on to this gateway's listeners, until cancelled."""
        store = self._job_store.blocking
        if store.announces:
            await listen(store.engine, self._channels, on_connected=self._on_connected)
        else:
            await self._poll()

    def _on_change(self, text: str) -> None:
        writer, job, news = text.split(" ")
        if writer == self._job_store.blocking.origin:
            return
        self._job_store.notifier.notify(job)
        if (waiting := self._queued.pop(job, None)) is not None:
            waiting.cancel()
        if news == State.QUEUED:
            self._queued[job] = asyncio.get_running_loop().call_later(_FIRST_REFUSAL_S, self._look_at_queue, job)
        elif news == State.CANCELLING:
            self._cancel(job)

    def _look_at_queue(self, job: str) -> None:
        """Wake the dispatcher: another gateway queued a job and found no free slot for it."""
        del self._queued[job]
        self._wake()

    def _on_connected(self) -> None:
        """Refresh everything after a reconnect: notifications sent while disconnected were lost."""
        self._job_store.notifier.notify_all()
        self._report_connected()
        self._wake()

    async def _poll(self) -> None:
        """One cheap query per second for all listeners; the dispatcher looks at the queue by itself."""
        last = await self._job_store.read(JobStore.newest_event_id)
        while True:
            await asyncio.sleep(_POLL_S)
            try:
                last, touched = await self._job_store.read(JobStore.jobs_changed_since, last)
            except SQLAlchemyError:
                _log.exception("the jobs database cannot be read; trying again")
                continue
            for job in touched:
                self._job_store.notifier.notify(job)
