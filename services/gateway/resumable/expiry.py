"""Removal of uploads that have expired, and of what crashes have left on the store of those that have ended."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable

from sqlalchemy.exc import SQLAlchemyError

from capture2vr.gateway.resumable.uploads import ResumableUploads
from capture2vr.storage.store import Store
from capture2vr.storage.tenant_store import store_of_tenant

KEEP_S = 86_400.0
"""Seconds for which an ended upload is remembered: who lost the last answer still learns the capture's id."""
_EVERY_S = 60.0

_log = logging.getLogger(__name__)


class Expiry:
    """Removes expired uploads now and then. Every gateway may do it at the same time: doing it twice does no harm.

    on_removed  called with the tenant, and minus the bytes that an expired upload had
    """

    def __init__(
        self, uploads: ResumableUploads, store: Store, on_removed: Callable[[str, int], Awaitable[None]]
    ) -> None:
        self._uploads = uploads
        self._store = store
        self._on_removed = on_removed

    async def run(self) -> None:
        """Remove what is due, until cancelled."""
        while True:
            try:
                await self.remove_due(time.time())
            except (OSError, SQLAlchemyError) as error:
                _log.warning("expired uploads could not be removed: %s", error)
            await asyncio.sleep(_EVERY_S)

    async def remove_due(self, now: float) -> None:
        """Remove expired uploads, sweep those that have ended, and forget the oldest."""
        database = self._uploads.database
        for upload in await self._uploads.run(lambda: database.remove_expired(now)):
            _log.info("upload %s of %s has expired after %d bytes", upload.id, upload.tenant, upload.received)
            await self._uploads.discard_capture(upload, store_of_tenant(self._store, upload.tenant))
            await self._on_removed(upload.tenant, -upload.received)
        kept_since = now - KEEP_S
        for upload in await self._uploads.run(lambda: database.to_sweep(kept_since)):
            await self._uploads.sweep(upload, store_of_tenant(self._store, upload.tenant), kept_since)
