"""Database tables of tenants, their usage, keys, pairings, shares and secrets, as the migrations have made them."""

from __future__ import annotations

import sqlalchemy as sa

from capture2vr.gateway.database.database import metadata

tenants = sa.Table(
    "tenants",
    metadata,
    sa.Column("name", sa.String(32), primary_key=True),
    sa.Column("label", sa.String(200), nullable=False),
    sa.Column("created", sa.Double, nullable=False),
    sa.Column("limits", sa.JSON),
    sa.Column("retention", sa.JSON),
)

usage = sa.Table(
    "usage",
    metadata,
    sa.Column("tenant", sa.ForeignKey("tenants.name"), primary_key=True),
    sa.Column("stored_bytes", sa.BigInteger, nullable=False),
    sa.Column("measured", sa.Double, nullable=False),
)

api_keys = sa.Table(
    "api_keys",
    metadata,
    sa.Column("id", sa.String(32), primary_key=True),
    sa.Column("tenant", sa.ForeignKey("tenants.name"), nullable=False, index=True),
    sa.Column("label", sa.String(200), nullable=False),
    sa.Column("sha256", sa.String(64), nullable=False, unique=True),
    sa.Column("scopes", sa.String(100), nullable=False),
    sa.Column("created", sa.Double, nullable=False),
    sa.Column("expires", sa.Double),
    sa.Column("last_used", sa.Double),
    sa.Column("revoked", sa.Double),
    sa.Column("parent", sa.String(32), index=True),
)

pairings = sa.Table(
    "pairings",
    metadata,
    sa.Column("id", sa.String(32), primary_key=True),
    sa.Column("tenant", sa.ForeignKey("tenants.name"), nullable=False),
    sa.Column("label", sa.String(200), nullable=False),
    sa.Column("scopes", sa.String(100), nullable=False),
    sa.Column("token_sha256", sa.String(64), nullable=False, unique=True),
    sa.Column("code", sa.String(10), nullable=False),
    sa.Column("expires", sa.Double, nullable=False),
    sa.Column("key_expires", sa.Double),
    sa.Column("key", sa.ForeignKey("api_keys.id")),
    sa.Column("parent", sa.String(32)),
)

ended_sessions = sa.Table(
    "ended_sessions",
    metadata,
    sa.Column("sha256", sa.String(64), primary_key=True),
    sa.Column("until", sa.Double, nullable=False),
)

shares = sa.Table(
    "shares",
    metadata,
    sa.Column("id", sa.String(32), primary_key=True),
    sa.Column("tenant", sa.ForeignKey("tenants.name"), nullable=False),
    sa.Column("kind", sa.String(16), nullable=False),
    sa.Column("name", sa.String(100), nullable=False),
    sa.Column("mode", sa.String(16), nullable=False),
    sa.Column("label", sa.String(200), nullable=False),
    sa.Column("password", sa.String(200), nullable=False),
    sa.Column("created", sa.Double, nullable=False),
    sa.Column("expires", sa.Double),
    sa.Column("revoked", sa.Double),
    sa.Column("opened", sa.Integer, nullable=False),
    sa.Column("last_opened", sa.Double),
    sa.Index("ix_shares_tenant_id", "tenant", "id"),
)

secrets = sa.Table(
    "secrets",
    metadata,
    sa.Column("name", sa.String(32), primary_key=True),
    sa.Column("value", sa.String(64), nullable=False),
)
