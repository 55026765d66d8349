"""Background task that sends the messages of the outbox: several at once, but one at a time to each webhook."""

from __future__ import annotations

import asyncio
import logging
import random
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import TypeVar

from sqlalchemy.exc import SQLAlchemyError

from capture2vr.gateway.waiting import happens_within
from capture2vr.gateway.webhooks.outbox import Delivery, Outbox
from capture2vr.gateway.webhooks.send import Outcome, Sender

_AT_ONCE = 16  # a receiver that never answers holds its own place for a quarter of a minute; see PLACES_A_TENANT
_POLL_S = 1.0  # between looks at the outbox, which other gateways fill too
_CLEAN_S = 3_600.0
_JITTER = 0.1  # of a wait that a receiver asks for, so that messages that failed together do not return together

_T = TypeVar("_T")

_log = logging.getLogger(__name__)


class Deliveries:
    """Sends what is due. observe: called with "delivered", "failed" or "gone" for each attempt"""

    def __init__(self, outbox: Outbox, sender: Sender, observe: Callable[[str], None]) -> None:
        self._outbox = outbox
        self._sender = sender
        self._observe = observe
        self._busy: dict[str, asyncio.Task[None]] = {}
        self._wake = asyncio.Event()
        self._threads = ThreadPoolExecutor(1, "webhooks")
        self._cleaned = 0.0

    async def check(self, url: str) -> None:
        """Raises UrlRefused, OSError for a URL that no message would be sent to now."""
        await self._sender.check(url)

    def wake(self) -> None:
        """Wake the delivery loop: look for new messages in the outbox now."""
        self._wake.set()

    async def run(self) -> None:
        """Send messages until cancelled. One that was being sent then is sent again later, with the same id."""
        try:
            while True:
                self._wake.clear()
                try:
                    await self._send_due()
                except SQLAlchemyError as error:
                    _log.warning("the outbox of webhooks cannot be read, trying again: %s", error)
                await happens_within(self._wake, _POLL_S)
        finally:
            for task in self._busy.values():
                task.cancel()
            await asyncio.gather(*self._busy.values(), return_exceptions=True)
            await self._sender.close()
            self._threads.shutdown()

    async def _send_due(self) -> None:
        free = _AT_ONCE - len(self._busy)
        now = time.time()
        due = await self._run(self._outbox.next_due)
        if free and due is not None and due <= now:
            busy = set(self._busy)
            for delivery in await self._run(lambda: self._outbox.claim(now, free, busy)):
                webhook = delivery.message.webhook
                self._busy[webhook] = task = asyncio.create_task(self._deliver(delivery))
                task.add_done_callback(partial(self._ended, webhook))
        if now - self._cleaned > _CLEAN_S:
            self._cleaned = now
            await self._run(lambda: self._outbox.remove_old(now))

    def _ended(self, webhook: str, _: asyncio.Task[None]) -> None:
        self._busy.pop(webhook, None)
        self.wake()

    async def _deliver(self, delivery: Delivery) -> None:
        outcome = await self._sender.send(delivery)
        message, now = delivery.message, time.time()
        try:
            if outcome.delivered:
                await self._run(lambda: self._outbox.delivered(message, outcome.answer, now))
            else:
                await self._run(lambda: self._record_failure(delivery, outcome, now))
        except SQLAlchemyError as error:  # its lease ends, and it is sent again with the same id
            _log.warning("webhook message %s: what became of it could not be stored: %s", message.id, error)
        self._observe("delivered" if outcome.delivered else "gone" if outcome.gone else "failed")

    def _record_failure(self, delivery: Delivery, outcome: Outcome, now: float) -> None:
        message = delivery.message
        _log.info("webhook %s: message %s was not delivered: %s", message.webhook, message.id, outcome.answer[:200])
        wait_s = outcome.wait_s * (1 + random.uniform(0, _JITTER))
        self._outbox.failed(message, outcome.answer, now, wait_s=wait_s)
        if outcome.gone:
            self._outbox.disable(message.webhook, now)

    async def _run(self, work: Callable[[], _T]) -> _T:
        return await asyncio.get_running_loop().run_in_executor(self._threads, work)
