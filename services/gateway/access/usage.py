"""What each tenant stores, in bytes: counted over its objects now and then, and kept up by uploads and deletions.

Workers publish assets past the gateway, so the sum is right only to within the last count.
"""

from __future__ import annotations

import asyncio
import logging
import time
from dataclasses import dataclass, replace

from sqlalchemy.exc import SQLAlchemyError

from capture2vr.gateway.access.authentication import Authentication
from capture2vr.gateway.access.limits import TenantLimits, capture_too_large, too_much_stored
from capture2vr.gateway.errors import Problem
from capture2vr.sentences.sentence import say
from capture2vr.storage.store import Store, list_all
from capture2vr.storage.tenant_store import DEFAULT_TENANT, FOLDER, store_of_tenant

FRESH_S = 600.0
"""Seconds after which a tenant's objects are counted anew, when it uploads next."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Allowance:
    """How large an upload may be: as one capture, and beside what is stored already. 0: no limit"""

    capture_bytes: int
    stored_limit: int = 0
    stored_bytes: int = 0

    def without(self, size: int) -> Allowance:
        """Return the allowance once so many of the stored bytes are gone, as those of an upload that is finished."""
        return replace(self, stored_bytes=max(0, self.stored_bytes - size))

    def check(self, size: int) -> None:
        """Raises Problem CAPTURE_BYTES_LIMITED, STORED_BYTES_LIMITED for a capture of this size."""
        if self.capture_bytes and size > self.capture_bytes:
            raise capture_too_large(self.capture_bytes)
        if self.stored_limit and self.stored_bytes + size > self.stored_limit:
            raise too_much_stored(self.stored_limit, self.stored_bytes)


class Usage:
    """Knows what tenants store. Event loop only."""

    def __init__(self, authentication: Authentication, store: Store) -> None:
        self._authentication = authentication
        self._store = store
        self._counting: dict[str, asyncio.Task[int]] = {}

    async def allowance(self, tenant: str, limits: TenantLimits) -> Allowance:
        """Return how large an upload of the tenant may be now. Raises Problem STORE_UNAVAILABLE."""
        stored = await self.stored_bytes(tenant) if limits.stored_bytes else 0
        return Allowance(limits.capture_bytes, limits.stored_bytes, stored)

    async def stored_bytes(self, tenant: str) -> int:
        """Return what a tenant stores; counted now if it never was, and in the background if that is long ago.

        Raises Problem STORE_UNAVAILABLE where it must be counted now and cannot.
        """
        access = self._authentication.store
        found = await self._authentication.run(lambda: access.usage(tenant))
        if found is None:
            try:
                return await self._count(tenant)
            except OSError as error:
                raise Problem(503, "STORE_UNAVAILABLE", say("store_does_not_answer"), retryable=True) from error
        stored, measured = found
        if time.time() - measured > FRESH_S:
            self._count(tenant)
        return stored

    async def add(self, tenant: str, stored: int) -> None:
        """Add the bytes of an upload, or subtract those of a deletion."""
        access = self._authentication.store
        try:
            await self._authentication.run(lambda: access.add_usage(tenant, stored))
        except SQLAlchemyError as error:  # the capture is stored: the next count finds it
            _log.warning("what %s stores could not be noted: %s", tenant, error)

    def _count(self, tenant: str) -> asyncio.Task[int]:
        """Count a tenant's objects, unless that goes on already."""
        if tenant not in self._counting:
            task = asyncio.create_task(self._counted(tenant))
            self._counting[tenant] = task
            task.add_done_callback(lambda _: self._counting.pop(tenant, None))
        return self._counting[tenant]

    async def _counted(self, tenant: str) -> int:
        stored = await asyncio.to_thread(count_bytes, self._store, tenant)
        access = self._authentication.store
        await self._authentication.run(lambda: access.set_usage(tenant, stored, time.time()))
        return stored


def count_bytes(store: Store, tenant: str) -> int:
    """Return the bytes of all objects of a tenant. Raises OSError."""
    heads = list_all(store_of_tenant(store, tenant), "")
    others = FOLDER if tenant == DEFAULT_TENANT else "\0"
    return sum(head.size for head in heads if not head.name.startswith(others))
