"""Audit log, receipts of deletions, and how long tenants keep things."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0006_records"
down_revision = "0005_uploads"


def upgrade() -> None:
    op.create_table(
        "audit_log",
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
    )
    op.create_index("ix_audit_log_tenant_id", "audit_log", ["tenant", "id"])
    for statement in _POSTGRES if op.get_bind().dialect.name == "postgresql" else _SQLITE:
        op.execute(statement)
    op.create_table(
        "deletions",
        sa.Column("id", sa.String(40), primary_key=True),
        sa.Column("tenant", sa.String(32), nullable=False),
        sa.Column("at", sa.Double, nullable=False),
        sa.Column("receipt", sa.JSON, nullable=False),
    )
    op.create_index("ix_deletions_tenant_id", "deletions", ["tenant", "id"])
    op.add_column("tenants", sa.Column("retention", sa.JSON))


# Append-only for whoever has the gateway's database access: to change a row, somebody must drop a trigger first.
_SQLITE = [
    f"CREATE TRIGGER audit_log_no_{change.lower()} BEFORE {change} ON audit_log "
    "BEGIN SELECT RAISE(ABORT, 'the audit log is append-only'); END"
    for change in ("UPDATE", "DELETE")
]
_POSTGRES = [
    "CREATE FUNCTION refuse_audit_change() RETURNS trigger AS "
    "$$ BEGIN RAISE EXCEPTION 'the audit log is append-only'; END $$ LANGUAGE plpgsql",
    "CREATE TRIGGER audit_log_append_only BEFORE UPDATE OR DELETE OR TRUNCATE ON audit_log "
    "FOR EACH STATEMENT EXECUTE FUNCTION refuse_audit_change()",
]
