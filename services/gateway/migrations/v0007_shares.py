"""Share links of assets and collections."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0007_shares"
down_revision = "0006_records"


def upgrade() -> None:
    op.create_table(
        "shares",
        sa.Column("id", sa.String(32), primary_key=True),
        sa.Column("tenant", sa.String(32), sa.ForeignKey("tenants.name"), nullable=False),
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
    )
    op.create_index("ix_shares_tenant_id", "shares", ["tenant", "id"])
