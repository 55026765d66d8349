"""Pairing codes have ten digits, and no limit for all addresses together."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0010_longer_codes"
down_revision = "0009_credentials"


def upgrade() -> None:
    with op.batch_alter_table("pairings") as pairings:
        pairings.alter_column("code", existing_type=sa.String(6), type_=sa.String(10), existing_nullable=False)
