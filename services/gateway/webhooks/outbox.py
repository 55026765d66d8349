"""Outbox of webhook messages: written in the transaction of the change that they tell, sent later, kept for a week.

A message has one id however often it is sent, so that a receiver which has seen it can ignore it.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Connection, Engine

from capture2vr.gateway.database.database import for_writing, insert_if_absent
from capture2vr.gateway.webhooks.tables import messages, webhooks

EVENTS = (
    "job.running",
    "job.succeeded",
    "job.failed",
    "job.cancelled",
    "asset.published",
    "asset.held",
    "asset.removed",
    "asset.restored",
    "asset.deleted",
    "data.deleted",
)
TEST_EVENT = "webhook.test"
DELAYS_S = (5, 60, 300, 1_800, 7_200, 14_400, 21_600, 21_600, 21_600)
"""Seconds to wait after each failed attempt: ten attempts over 24 hours and a half."""
KEEP_S = 7 * 86_400.0
"""Seconds for which a message that was delivered or given up can be sent again."""
PLACES_A_TENANT = 8
"""Most messages of one tenant that are sent at once: half of a gateway's places, so that others find one free."""
_STEP_S = 1e-6  # the least that a time of today in seconds, as a double, keeps apart with certainty
_LEASE_S = 60.0  # for one attempt: longer than any takes; a gateway that died in the middle is then followed by another


@dataclass(frozen=True, slots=True)
class WebhookEvent:
    """A change that webhooks tell. name: what makes it one and the same event, however often it is reported"""

    type: str
    name: str
    data: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Message:
    """A message of the outbox. Times are seconds since the epoch.

    due          when it is sent next; None: never again
    ended        when it was delivered or given up; None: neither yet
    last_answer  what the receiver answered last, or why it could not be asked
    """

    id: str
    webhook: str
    tenant: str
    type: str
    payload: str
    created: float
    attempts: int
    due: float | None
    ended: float | None
    delivered: bool
    last_answer: str


@dataclass(frozen=True, slots=True)
class Delivery:
    """A message that is to be sent now, where to, and the secrets that sign it: the newest first."""

    message: Message
    url: str
    secrets: tuple[str, ...]


_ENABLED = sa.select(webhooks.c.id, webhooks.c.events).where(
    webhooks.c.tenant == sa.bindparam("of_tenant"), webhooks.c.disabled.is_(None)
)


def new_messages(db: Connection, tenant: str, events: Sequence[WebhookEvent]) -> list[dict[str, Any]]:
    """Create the outbox rows for a tenant's events: one message for each webhook that subscribes to the event."""
    enabled = db.execute(_ENABLED, {"of_tenant": tenant}).all() if events else []
    now = time.time()  # with a step between events that come together: they are sent in the order of their times
    return [
        new_message(row.id, tenant, event, _payload(event), now + number * _STEP_S)
        for number, event in enumerate(events)
        for row in enabled
        if not row.events or event.type in row.events
    ]


def enqueue(db: Connection, rows: Iterable[Mapping[str, Any]]) -> None:
    """Put rows of `new_messages` into the outbox; one that is there already stays as it is."""
    for row in rows:
        insert_if_absent(db, messages, row)


def new_message(webhook: str, tenant: str, event: WebhookEvent, payload: str, now: float) -> dict[str, Any]:
    """Return a new row of the outbox."""
    digest = hashlib.sha256(f"{webhook} {event.type} {event.name}".encode()).hexdigest()
    return {
        # Begins with the time, so that lists are in its order; of a repeated event the first row stays.
        "id": f"msg_{digest[:40]}",
        "webhook": webhook,
        "tenant": tenant,
        "type": event.type,
        "payload": payload,
        "created": now,
        "attempts": 0,
        "due": now,
        "ended": None,
        "delivered": False,
        "last_answer": "",
    }


def payload_of(event: WebhookEvent) -> str:
    """Return the body of an event's message, as Standard Webhooks has it."""
    return _payload(event)


class Outbox:
    """Claims messages that are due, and records what became of them. Methods block."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._writer = for_writing(engine)
        self._locks = engine.dialect.name != "sqlite"

    def enqueue(self, tenant: str, event: WebhookEvent) -> None:
        """Put an event into the outbox."""
        with self._writer.begin() as db:
            enqueue(db, new_messages(db, tenant, (event,)))

    def claim(self, now: float, most: int, busy: set[str]) -> list[Delivery]:
        """Lease at most `most` messages that are due, one for each webhook that is not `busy`.

        The tenants take turns: the next message is of the tenant with the fewest busy webhooks, and of several the one
        that is due longest. No tenant has more than PLACES_A_TENANT at once, those of `busy` webhooks included.
        """
        due = sa.and_(messages.c.due <= now, webhooks.c.disabled.is_(None), messages.c.webhook.not_in(list(busy)))
        claimed = []
        with self._writer.begin() as db:
            for webhook in db.execute(_webhooks_by_turn(due, busy).limit(most)).scalars().all():
                select = sa.select(
                    messages, webhooks.c.url, webhooks.c.secret, webhooks.c.old_secret, webhooks.c.old_until
                )
                select = select.join(webhooks).where(due, messages.c.webhook == webhook)
                select = select.order_by(messages.c.due, messages.c.created).limit(1)
                row = db.execute(select.with_for_update(skip_locked=True) if self._locks else select).first()
                if row is not None:
                    db.execute(messages.update().where(messages.c.id == row.id).values(due=now + _LEASE_S))
                    claimed.append(_delivery(row, now))
        return claimed

    def next_due(self) -> float | None:
        """Return when the next message is due; None where the outbox is empty."""
        select = sa.select(sa.func.min(messages.c.due)).join(webhooks).where(webhooks.c.disabled.is_(None))
        with self._engine.begin() as db:
            found = db.execute(select).scalar()
        return None if found is None else float(found)

    def delivered(self, message: Message, answer: str, now: float) -> None:
        """Record that a message was delivered."""
        self._end(message, now, delivered=True, attempts=message.attempts + 1, last_answer=answer[:300])

    def failed(self, message: Message, answer: str, now: float, *, wait_s: float = 0.0) -> None:
        """Record a failed attempt, and when the next one is due; after the last one the message is given up.

        wait_s  the least time to the next attempt, as the receiver asked for
        """
        attempts = message.attempts + 1
        if attempts > len(DELAYS_S):
            self._end(message, now, delivered=False, attempts=attempts, last_answer=answer[:300])
            return
        due = now + max(wait_s, DELAYS_S[attempts - 1])
        with self._writer.begin() as db:
            values = {"attempts": attempts, "due": due, "last_answer": answer[:300]}
            db.execute(messages.update().where(messages.c.id == message.id).values(values))

    def disable(self, webhook: str, now: float) -> None:
        """Disable a webhook whose receiver says that it is gone; its messages wait until it is enabled again."""
        with self._writer.begin() as db:
            db.execute(webhooks.update().where(webhooks.c.id == webhook).values(disabled=now))

    def delete_of(self, tenant: str) -> None:
        """Delete the messages of a tenant that have ended: they name its assets."""
        with self._writer.begin() as db:
            db.execute(messages.delete().where(messages.c.tenant == tenant, messages.c.ended.is_not(None)))

    def remove_old(self, now: float) -> int:
        """Delete messages that ended more than a week ago; return how many."""
        with self._writer.begin() as db:
            return db.execute(messages.delete().where(messages.c.ended < now - KEEP_S)).rowcount

    def _end(self, message: Message, now: float, **values: Any) -> None:
        with self._writer.begin() as db:
            ended = {"due": None, "ended": now, **values}
            db.execute(messages.update().where(messages.c.id == message.id).values(ended))


def _webhooks_by_turn(due: sa.ColumnElement[bool], busy: set[str]) -> sa.Select[tuple[str]]:
    """Select the webhooks that have a due message, in the order in which they are served."""
    mine = webhooks.alias()
    held = sa.select(sa.func.count()).where(mine.c.tenant == webhooks.c.tenant, mine.c.id.in_(list(busy)))
    oldest = sa.func.min(messages.c.due)
    number = sa.func.row_number().over(partition_by=webhooks.c.tenant, order_by=(oldest, messages.c.webhook))
    columns = (messages.c.webhook, oldest.label("oldest"), (number + held.scalar_subquery()).label("place"))
    waiting = sa.select(*columns).join(webhooks).where(due).group_by(messages.c.webhook, webhooks.c.tenant).subquery()
    served = sa.select(waiting.c.webhook).where(waiting.c.place <= PLACES_A_TENANT)
    return served.order_by(waiting.c.place, waiting.c.oldest, waiting.c.webhook)


def _payload(event: WebhookEvent) -> str:
    now = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    document = {"type": event.type, "timestamp": now, "data": event.data}
    return json.dumps(document, ensure_ascii=False, separators=(",", ":"))


def message_from_row(row: Any) -> Message:
    """Convert a row of the outbox."""
    return Message(**{column.name: getattr(row, column.name) for column in messages.c})


def _delivery(row: Any, now: float) -> Delivery:
    old = (row.old_secret,) if row.old_secret and (row.old_until or 0.0) > now else ()
    return Delivery(message_from_row(row), row.url, (row.secret, *old))
