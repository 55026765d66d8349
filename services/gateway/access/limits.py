"""Limits of tenants and of addresses: how many requests a minute, uploads and jobs at once, jobs a day, bytes."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

from cachetools import TTLCache
from limits import RateLimitItem, RateLimitItemPerMinute, RateLimitItemPerSecond
from limits.storage import MemoryStorage
from limits.strategies import SlidingWindowCounterRateLimiter

from capture2vr.gateway.access.authentication import CACHE_S, Authentication
from capture2vr.gateway.access.caller import Caller
from capture2vr.gateway.errors import Problem
from capture2vr.gateway.own_address import is_own
from capture2vr.gateway.settings import GatewaySettings
from capture2vr.sentences.sentence import say

_UPLOAD_RETRY_S = 5
_TENANTS = 20_000  # whose limits are cached
_MOVES = RateLimitItemPerSecond(50)  # of one scene: each of those who move things in it reports 10 times a second


@dataclass(frozen=True, slots=True)
class TenantLimits:
    """What a tenant may do; 0 is no limit.

    jobs_at_once             counts those that have not ended
    job_seconds              that one job may compute; those of operators may compute as long as a worker lets them
    processor_s_per_minute   for the checks and inspections of its uploads
    presets                  that its jobs may name; none: all but the methods from the literature, which operators may
    """

    requests_per_minute: int = 0
    uploads_at_once: int = 0
    jobs_at_once: int = 0
    jobs_per_day: int = 0
    stored_bytes: int = 0
    capture_bytes: int = 0
    job_seconds: int = 0
    processor_s_per_minute: int = 0
    presets: tuple[str, ...] = ()

    @classmethod
    def of(cls, settings: GatewaySettings) -> TenantLimits:
        """Return the limits in the settings, which hold for tenants without limits of their own."""
        return cls(**{field.name: getattr(settings, f"limit_{field.name}") for field in fields(cls)})

    def with_own(self, own: Mapping[str, Any] | None) -> TenantLimits:
        """Return these limits with a tenant's own in their places."""
        found = replace(self, **(own or {}))
        return replace(found, presets=tuple(found.presets))

    def document(self) -> dict[str, Any]:
        """Return the limits by name."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class RateState:
    """Where a caller stands: `limit` requests in 60 s, of which `remaining` are left, all again after `reset_s`."""

    limit: int
    remaining: int
    reset_s: int

    @property
    def headers(self) -> dict[str, str]:
        """The headers of draft-ietf-httpapi-ratelimit-headers-10."""
        return {
            "RateLimit-Policy": f'"requests";q={self.limit};w=60',
            "RateLimit": f'"requests";r={self.remaining};t={self.reset_s}',
        }


class Limits:
    """Counts requests and uploads in this process, and knows the limits of each tenant. Event loop only."""

    def __init__(self, settings: GatewaySettings, authentication: Authentication) -> None:
        self._defaults = TenantLimits.of(settings)
        self._of_address = settings.limit_address_requests_per_minute
        self._authentication = authentication
        self._limiter = SlidingWindowCounterRateLimiter(MemoryStorage())
        self._items: dict[int, RateLimitItem] = {}
        self._own: TTLCache[str, TenantLimits] = TTLCache(_TENANTS, CACHE_S)
        self._uploads = Counter[str]()

    async def of(self, tenant: str) -> TenantLimits:
        """Return a tenant's limits, as they were at most `CACHE_S` seconds ago."""
        found = self._own.get(tenant)
        if found is None:
            store = self._authentication.store
            found = self._defaults.with_own(await self._authentication.run(lambda: store.own_limits(tenant)))
            self._own[tenant] = found
        return found

    def forget(self, tenant: str) -> None:
        """Read a tenant's limits anew: they were changed here."""
        self._own.pop(tenant, None)

    def spend_address(self, address: str) -> RateState | None:
        """Count a request of an address. Raises Problem REQUESTS_LIMITED; None where it is not limited."""
        if not self._of_address or is_own(address):
            return None
        return self._spend(self._of_address, "address", address)

    async def spend(self, caller: Caller) -> RateState | None:
        """Count a request of a caller's tenant. Raises Problem REQUESTS_LIMITED; None where it is not limited."""
        if not caller.key:
            return None
        limit = (await self.of(caller.tenant)).requests_per_minute
        return self._spend(limit, "tenant", caller.tenant) if limit else None

    def spend_moves(self, tenant: str, scene: str) -> None:
        """Count a report of what is moving in a scene. Raises Problem MOVES_LIMITED."""
        if not self._limiter.hit(_MOVES, "moves", tenant, scene):
            detail = say("more_than_reports_second", count=_MOVES.amount)
            raise limited("MOVES_LIMITED", detail, 1, hint=say("report_less_often_nothing_lost"))

    @contextmanager
    def upload(self, tenant: str, most: int) -> Iterator[None]:
        """Count an upload while it lasts. Raises Problem UPLOADS_LIMITED where `most` of the tenant's go on already."""
        if most and self._uploads[tenant] >= most:
            detail = say("uploads_going_on_already", count=most)
            raise limited("UPLOADS_LIMITED", detail, _UPLOAD_RETRY_S, hint=say("wait_until_one_has_ended"))
        self._uploads[tenant] += 1
        try:
            yield
        finally:
            self._uploads[tenant] -= 1
            if not self._uploads[tenant]:
                del self._uploads[tenant]

    def _spend(self, limit: int, kind: str, name: str) -> RateState:
        item = self._items.setdefault(limit, RateLimitItemPerMinute(limit))
        accepted = self._limiter.hit(item, kind, name)
        stats = self._limiter.get_window_stats(item, kind, name)
        reset_s = max(1, math.ceil(stats.reset_time - time.time()))
        state = RateState(limit, max(0, stats.remaining), reset_s)
        if not accepted:
            detail = say("more_than_requests_minute", limit=limit)
            raise limited("REQUESTS_LIMITED", detail, reset_s, hint=say("ask_less_often"), headers=state.headers)
        return state


def limited(code: str, detail: str, retry_s: int, *, hint: str, headers: Mapping[str, str] | None = None) -> Problem:
    """Return the problem for a limit that is reached now, and not after `retry_s` seconds."""
    answer = {"Retry-After": str(retry_s), **(headers or {})}
    return Problem(
        429, code, detail, retryable=True, hints=(hint, say("try_again_in_s", seconds=retry_s)), headers=answer
    )


def too_much_stored(limit: int, stored: int) -> Problem:
    """Return the problem for a tenant whose store is full. Waiting does not help, so it is no 429."""
    detail = say("bytes_stored_would", stored=stored, limit=limit)
    return Problem(413, "STORED_BYTES_LIMITED", detail, hints=(say("delete_captures_assets"), say("ask_operator")))


def capture_too_large(limit: int) -> Problem:
    """Return the problem for a capture that is larger than the tenant's may be."""
    detail = say("capture_may_have_most_bytes", limit=limit)
    return Problem(413, "CAPTURE_BYTES_LIMITED", detail, hints=(say("send_smaller_capture"), say("ask_operator")))
