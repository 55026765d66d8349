"""Resumable uploads, and the chunks that the store has of them."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0005_uploads"
down_revision = "0004_webhooks"


def upgrade() -> None:
    op.create_table(
        "uploads",
        sa.Column("id", sa.String(40), primary_key=True),
        sa.Column("tenant", sa.String(32), sa.ForeignKey("tenants.name"), nullable=False),
        sa.Column("length", sa.BigInteger, nullable=False),
        sa.Column("received", sa.BigInteger, nullable=False),
        sa.Column("metadata", sa.JSON, nullable=False),
        sa.Column("expires", sa.Double, nullable=False),
        sa.Column("writer", sa.String(32), nullable=False),
        sa.Column("finisher", sa.String(32), nullable=False),
        sa.Column("finisher_until", sa.Double, nullable=False),
        sa.Column("capture", sa.String(40), nullable=False),
        sa.Column("ended", sa.Double),
        sa.Column("swept", sa.Boolean, nullable=False),
    )
    op.create_index("ix_uploads_tenant", "uploads", ["tenant"])
    op.create_index("ix_uploads_ended", "uploads", ["ended"])
    op.create_table(
        "upload_chunks",
        sa.Column("upload", sa.String(40), sa.ForeignKey("uploads.id"), primary_key=True),
        sa.Column("start", sa.BigInteger, primary_key=True),
        sa.Column("length", sa.Integer, nullable=False),
        sa.Column("writer", sa.String(32), nullable=False),
    )
