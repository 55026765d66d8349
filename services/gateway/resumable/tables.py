"""Database tables of resumable uploads and their chunks, as the migrations have made them."""

from __future__ import annotations

import sqlalchemy as sa

from capture2vr.gateway.database.database import metadata

uploads = sa.Table(
    "uploads",
    metadata,
    sa.Column("id", sa.String(40), primary_key=True),
    sa.Column("tenant", sa.ForeignKey("tenants.name"), nullable=False, index=True),
    sa.Column("length", sa.BigInteger, nullable=False),
    sa.Column("received", sa.BigInteger, nullable=False),
    sa.Column("metadata", sa.JSON, nullable=False),
    sa.Column("expires", sa.Double, nullable=False),
    sa.Column("writer", sa.String(32), nullable=False),
    sa.Column("finisher", sa.String(32), nullable=False),
    sa.Column("finisher_until", sa.Double, nullable=False),
    sa.Column("capture", sa.String(40), nullable=False),
    sa.Column("ended", sa.Double, index=True),
    sa.Column("swept", sa.Boolean, nullable=False),
)

chunks = sa.Table(
    "upload_chunks",
    metadata,
    sa.Column("upload", sa.ForeignKey("uploads.id"), primary_key=True),
    sa.Column("start", sa.BigInteger, primary_key=True),
    sa.Column("length", sa.Integer, nullable=False),
    sa.Column("writer", sa.String(32), nullable=False),
)
