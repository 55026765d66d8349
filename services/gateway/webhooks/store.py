"""Webhook store: the tenants' webhooks, and what became of their messages. Methods block."""

from __future__ import annotations

import base64
import secrets
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Engine

from capture2vr.gateway.database.database import for_writing
from capture2vr.gateway.webhooks.outbox import (
    TEST_EVENT,
    Message,
    WebhookEvent,
    message_from_row,
    new_message,
    payload_of,
)
from capture2vr.gateway.webhooks.tables import messages, webhooks

OLD_SECRET_S = 86_400.0
"""Seconds for which messages are signed with the old secret too, after a rotation."""
_SECRET_BYTES = 32


@dataclass(frozen=True, slots=True)
class Webhook:
    """A webhook of a tenant. events: which it wants, () for all; disabled: since when, or None"""

    id: str
    tenant: str
    label: str
    url: str
    events: tuple[str, ...]
    created: float
    disabled: float | None


class WebhookStore:
    """Webhooks in the database. A tenant sees its own alone."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._writer = for_writing(engine)

    def create(
        self, tenant: str, url: str, events: Sequence[str], label: str, *, most: int
    ) -> tuple[Webhook, str] | None:
        """Create a webhook; return it and its secret. None where the tenant has `most` already."""
        hook = Webhook(f"hook_{secrets.token_hex(8)}", tenant, label, url, tuple(events), time.time(), None)
        secret = new_secret()
        with self._writer.begin() as db:
            count = sa.select(sa.func.count()).where(webhooks.c.tenant == tenant)
            if db.execute(count).scalar_one() >= most:
                return None
            values = {"label": label, "url": url, "events": list(events), "created": hook.created}
            db.execute(webhooks.insert().values(id=hook.id, tenant=tenant, secret=secret, **values))
        return hook, secret

    def all(self, tenant: str) -> list[Webhook]:
        """Return a tenant's webhooks, the oldest first."""
        select = sa.select(webhooks).where(webhooks.c.tenant == tenant).order_by(webhooks.c.created)
        with self._engine.begin() as db:
            return [_webhook(row) for row in db.execute(select)]

    def get(self, tenant: str, webhook: str) -> Webhook | None:
        """Return a tenant's webhook, or None."""
        with self._engine.begin() as db:
            row = db.execute(sa.select(webhooks).where(_mine(tenant, webhook))).first()
        return _webhook(row) if row else None

    def rotate(self, tenant: str, webhook: str) -> str:
        """Give a webhook a new secret and return it; for a day messages are signed with the old one too."""
        secret = new_secret()
        with self._writer.begin() as db:
            values = {"old_secret": webhooks.c.secret, "old_until": time.time() + OLD_SECRET_S, "secret": secret}
            db.execute(webhooks.update().where(_mine(tenant, webhook)).values(values))
        return secret

    def set_disabled(self, tenant: str, webhook: str, *, disabled: bool) -> None:
        """Disable a webhook, or enable it again; messages that waited are sent then."""
        with self._writer.begin() as db:
            since = time.time() if disabled else None
            db.execute(webhooks.update().where(_mine(tenant, webhook)).values(disabled=since))

    def delete(self, tenant: str, webhook: str) -> None:
        """Delete a webhook with all its messages."""
        with self._writer.begin() as db:
            if db.execute(sa.select(webhooks.c.id).where(_mine(tenant, webhook))).first():
                db.execute(messages.delete().where(messages.c.webhook == webhook))
                db.execute(webhooks.delete().where(webhooks.c.id == webhook))

    def send_test(self, tenant: str, webhook: str) -> Message:
        """Put a test message for one webhook into the outbox."""
        event = WebhookEvent(TEST_EVENT, secrets.token_hex(8), {"webhook": webhook})
        row = new_message(webhook, tenant, event, payload_of(event), time.time())
        with self._writer.begin() as db:
            db.execute(messages.insert().values(row))
        return Message(**row)

    def page(self, tenant: str, webhook: str, *, limit: int, before: float) -> list[Message]:
        """Return at most `limit` messages of a webhook that were created before a time, the newest first."""
        mine = sa.and_(messages.c.webhook == webhook, messages.c.tenant == tenant, messages.c.created < before)
        select = sa.select(messages).where(mine).order_by(messages.c.created.desc()).limit(limit)
        with self._engine.begin() as db:
            return [message_from_row(row) for row in db.execute(select)]

    def redeliver(self, tenant: str, webhook: str, message: str) -> Message | None:
        """Send a message again, now and with all attempts; None where there is no such message."""
        mine = sa.and_(messages.c.id == message, messages.c.webhook == webhook, messages.c.tenant == tenant)
        with self._writer.begin() as db:
            values = {"due": time.time(), "attempts": 0, "ended": None, "delivered": False}
            db.execute(messages.update().where(mine).values(values))
            row = db.execute(sa.select(messages).where(mine)).first()
        return message_from_row(row) if row else None


def new_secret() -> str:
    """Make a secret as Standard Webhooks writes them."""
    return f"whsec_{base64.b64encode(secrets.token_bytes(_SECRET_BYTES)).decode()}"


def _mine(tenant: str, webhook: str) -> sa.ColumnElement[bool]:
    return sa.and_(webhooks.c.id == webhook, webhooks.c.tenant == tenant)


def _webhook(row: Any) -> Webhook:
    names = ("id", "tenant", "label", "url", "created", "disabled")
    return Webhook(**{name: getattr(row, name) for name in names}, events=tuple(row.events))
