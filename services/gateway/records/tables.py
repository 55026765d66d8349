"""Database tables of what was done and what was deleted, as the migrations have made them."""

from __future__ import annotations

import sqlalchemy as sa

from capture2vr.gateway.database.database import metadata

audit_log = sa.Table(
    "audit_log",
    metadata,
    # Triggers refuse to update or delete a row: see the migration.
    sa.Column("id", sa.BigInteger().with_variant(sa.Integer, "sqlite"), primary_key=True, autoincrement=True),
    sa.Column("at", sa.Double, nullable=False),
    sa.Column("tenant", sa.String(32), nullable=False),
    sa.Column("via", sa.String(16), nullable=False),
    sa.Column("key", sa.String(32), nullable=False),
    sa.Column("address", sa.String(64), nullable=False),
    sa.Column("request", sa.String(64), nullable=False),
    sa.Column("method", sa.String(8), nullable=False),
    sa.Column("path", sa.String(500), nullable=False),
    sa.Column("status", sa.Integer, nullable=False),
    sa.Index("ix_audit_log_tenant_id", "tenant", "id"),
)

deletions = sa.Table(
    "deletions",
    metadata,
    sa.Column("id", sa.String(40), primary_key=True),
    sa.Column("tenant", sa.String(32), nullable=False),
    sa.Column("at", sa.Double, nullable=False),
    sa.Column("receipt", sa.JSON, nullable=False),
    sa.Index("ix_deletions_tenant_id", "tenant", "id"),
)
