"""Tenants, their access keys and pairings; jobs belong to a tenant.

What is there already belongs to the tenant "default". The column of the jobs has that as its default, so that an older
gateway on the same database goes on while a newer one starts.
"""

from __future__ import annotations

import time

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"


def upgrade() -> None:
    tenants = op.create_table(
        "tenants",
        sa.Column("name", sa.String(32), primary_key=True),
        sa.Column("label", sa.String(200), nullable=False),
        sa.Column("created", sa.Double, nullable=False),
    )
    op.bulk_insert(tenants, [{"name": "default", "label": "", "created": time.time()}])
    op.create_table(
        "api_keys",
        sa.Column("id", sa.String(32), primary_key=True),
        sa.Column("tenant", sa.String(32), sa.ForeignKey("tenants.name"), nullable=False),
        sa.Column("label", sa.String(200), nullable=False),
        sa.Column("sha256", sa.String(64), nullable=False, unique=True),
        sa.Column("scopes", sa.String(100), nullable=False),
        sa.Column("created", sa.Double, nullable=False),
        sa.Column("expires", sa.Double),
        sa.Column("last_used", sa.Double),
        sa.Column("revoked", sa.Double),
    )
    op.create_index("ix_api_keys_tenant", "api_keys", ["tenant"])
    op.create_table(
        "pairings",
        sa.Column("id", sa.String(32), primary_key=True),
        sa.Column("tenant", sa.String(32), sa.ForeignKey("tenants.name"), nullable=False),
        sa.Column("label", sa.String(200), nullable=False),
        sa.Column("scopes", sa.String(100), nullable=False),
        sa.Column("token_sha256", sa.String(64), nullable=False, unique=True),
        sa.Column("code", sa.String(6), nullable=False),
        sa.Column("expires", sa.Double, nullable=False),
        sa.Column("key_expires", sa.Double),
        sa.Column("key", sa.String(32), sa.ForeignKey("api_keys.id")),
    )
    op.create_table(
        "secrets",
        sa.Column("name", sa.String(32), primary_key=True),
        sa.Column("value", sa.String(64), nullable=False),
    )
    op.add_column("jobs", sa.Column("tenant", sa.String(32), nullable=False, server_default="default"))
    op.add_column("jobs", sa.Column("token", sa.String(64), nullable=False, server_default=sa.text("''")))
    op.create_index("ix_jobs_tenant_id", "jobs", ["tenant", "id"])
