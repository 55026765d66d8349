"""Database tables of webhooks and of the outbox, as the migrations have made them."""

from __future__ import annotations

import sqlalchemy as sa

from capture2vr.gateway.database.database import metadata

webhooks = sa.Table(
    "webhooks",
    metadata,
    sa.Column("id", sa.String(32), primary_key=True),
    sa.Column("tenant", sa.ForeignKey("tenants.name"), nullable=False, index=True),
    sa.Column("label", sa.String(200), nullable=False),
    sa.Column("url", sa.String(2000), nullable=False),
    sa.Column("events", sa.JSON, nullable=False),
    sa.Column("secret", sa.String(100), nullable=False),
    sa.Column("old_secret", sa.String(100)),
    sa.Column("old_until", sa.Double),
    sa.Column("created", sa.Double, nullable=False),
    sa.Column("disabled", sa.Double),
)

messages = sa.Table(
    "webhook_messages",
    metadata,
    # Made from the webhook and the event, so that an event that is reported twice is one message.
    sa.Column("id", sa.String(64), primary_key=True),
    sa.Column("webhook", sa.ForeignKey("webhooks.id"), nullable=False),
    sa.Column("tenant", sa.String(32), nullable=False),
    sa.Column("type", sa.String(64), nullable=False),
    sa.Column("payload", sa.Text, nullable=False),
    sa.Column("created", sa.Double, nullable=False),
    sa.Column("attempts", sa.Integer, nullable=False),
    sa.Column("due", sa.Double, index=True),
    sa.Column("ended", sa.Double),
    sa.Column("delivered", sa.Boolean, nullable=False),
    sa.Column("last_answer", sa.String(300), nullable=False),
    sa.Index("ix_webhook_messages_webhook_id", "webhook", "id"),
)
