"""Let a few uploads at once be checked and inspected: tenants take turns, and each has a budget of processor time."""

from __future__ import annotations

import asyncio
import itertools
import math
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from functools import partial

from cachetools import LRUCache

from capture2vr.gateway.access.limits import limited
from capture2vr.gateway.errors import RETRY_S, Problem
from capture2vr.sentences.sentence import say

_AT_ONCE = 4  # checks, each with up to 768 MB; more would slow each other down on a small machine
_MOST_AT_ONCE = 8  # with the first of tenants that have none yet: what others send does not make those wait
_WAIT_S = 60.0  # for a turn: a phone on a bad line keeps a silent connection no longer
_TENANTS = 20_000  # whose budgets are remembered

Spend = Callable[[float], None]
"""Counts processor seconds for the tenant whose turn it is."""


@dataclass(frozen=True, slots=True)
class _Budget:
    """Processor seconds that a tenant has used up lately: so many at a time; what it may use a minute goes by."""

    used_s: float = 0.0
    at: float = 0.0

    def left_over(self, most_s: float, now: float) -> float:
        """Return the used seconds that count still, where `most_s` a minute are allowed."""
        return max(0.0, self.used_s - (now - self.at) * most_s / 60.0)

    def wait_s(self, most_s: float, now: float) -> float:
        """Return the seconds until there is something left to use."""
        return max(0.0, self.left_over(most_s, now) - most_s) * 60.0 / most_s if most_s else 0.0


@dataclass(eq=False, slots=True)
class _Place:
    """A place in the line. most_s: processor seconds a minute of its tenant, 0: as many as it needs"""

    tenant: str
    most_s: float
    turn: asyncio.Future[None] = field(default_factory=lambda: asyncio.get_running_loop().create_future())


class Turns:
    """The line of uploads that wait to be checked and inspected. Event loop only.

    Next is the first upload of the tenant of which the fewest are worked on; of several such tenants, of that whose
    last turn is longest ago.
    """

    def __init__(self) -> None:
        self._line: list[_Place] = []
        self._running = Counter[str]()
        self._budgets: LRUCache[str, _Budget] = LRUCache(_TENANTS)
        self._served: LRUCache[str, int] = LRUCache(_TENANTS)  # number of the last turn
        self._numbers = itertools.count(1)
        self._alarm: asyncio.TimerHandle | None = None

    @asynccontextmanager
    async def turn(self, tenant: str, most_s: float) -> AsyncIterator[Spend]:
        """Wait in the line, and hold a turn for the block; yields what counts the processor seconds that it costs.

        most_s  processor seconds a minute that the tenant may use; 0: no limit

        Raises Problem UPLOADS_BUSY, PROCESSOR_LIMITED.
        """
        place = _Place(tenant, most_s)
        if self._wait_s(place) > _WAIT_S:
            raise self._over_budget(place)
        self._line.append(place)
        self._go_on()
        try:
            try:
                async with asyncio.timeout(_WAIT_S):
                    await place.turn
            except TimeoutError:
                raise self._refusal(place) from None
            yield partial(self._spend, place)
        finally:
            if place in self._line:
                self._line.remove(place)
            else:
                self._running[tenant] -= 1
                self._running += Counter()  # forgets the tenants without any
            self._go_on()

    def _go_on(self) -> None:
        """Give the turns that are free now, and come back when a budget has something left again."""
        while place := self._next():
            self._line.remove(place)
            self._running[place.tenant] += 1
            self._served[place.tenant] = next(self._numbers)
            place.turn.set_result(None)
        if self._alarm is not None:
            self._alarm.cancel()
            self._alarm = None
        if (soonest := min(filter(None, map(self._wait_s, self._line)), default=0.0)) > 0.0:
            self._alarm = asyncio.get_running_loop().call_later(soonest, self._go_on)

    def _next(self) -> _Place | None:
        first: dict[str, _Place] = {}
        for place in self._line:
            if not place.turn.done():  # else it has just been given up
                first.setdefault(place.tenant, place)
        ready = (place for place in first.values() if self._may_start(place))
        return min(ready, key=lambda each: (self._running[each.tenant], self._served.get(each.tenant, 0)), default=None)

    def _may_start(self, place: _Place) -> bool:
        most = _AT_ONCE if self._running[place.tenant] else _MOST_AT_ONCE
        return self._running.total() < most and not self._wait_s(place)

    def _wait_s(self, place: _Place) -> float:
        return self._budgets.get(place.tenant, _Budget()).wait_s(place.most_s, time.monotonic())

    def _spend(self, place: _Place, seconds: float) -> None:
        now = time.monotonic()
        before = self._budgets.get(place.tenant, _Budget())
        self._budgets[place.tenant] = _Budget(before.left_over(place.most_s, now) + seconds, now)

    def _refusal(self, place: _Place) -> Problem:
        """Return the problem of who has waited too long."""
        if self._wait_s(place):
            return self._over_budget(place)
        detail = say("uploads_are_before_yours", count=self._line.index(place))
        return Problem(503, "UPLOADS_BUSY", detail, retryable=True, headers={"Retry-After": str(RETRY_S)})

    def _over_budget(self, place: _Place) -> Problem:
        detail = say("uploads_took_processor_seconds", limit=place.most_s)
        wait_s = max(1, math.ceil(self._wait_s(place)))
        return limited("PROCESSOR_LIMITED", detail, wait_s, hint=say("send_uploads_one_by_one"))
