"""Keys and pairings know the key that they come from, and sessions can be ended on the server."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0009_credentials"
down_revision = "0008_queue"


def upgrade() -> None:
    # No foreign keys: SQLite can add a column with one only by copying the table, and keys are never deleted.
    op.add_column("api_keys", sa.Column("parent", sa.String(32)))
    op.create_index("ix_api_keys_parent", "api_keys", ["parent"])
    op.add_column("pairings", sa.Column("parent", sa.String(32)))
    op.create_table(
        "ended_sessions",
        sa.Column("sha256", sa.String(64), primary_key=True),
        sa.Column("until", sa.Double, nullable=False),
    )
