"""Limits of a tenant, what it stores, and when the queue served it last."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0003_limits"
down_revision = "0002"


def upgrade() -> None:
    op.add_column("tenants", sa.Column("limits", sa.JSON))
    op.create_table(
        "usage",
        sa.Column("tenant", sa.String(32), sa.ForeignKey("tenants.name"), primary_key=True),
        sa.Column("stored_bytes", sa.BigInteger, nullable=False),
        sa.Column("measured", sa.Double, nullable=False),
    )
    op.create_table(
        "queue_turns",
        sa.Column("tenant", sa.String(32), primary_key=True),
        sa.Column("served", sa.Double, nullable=False),
    )
