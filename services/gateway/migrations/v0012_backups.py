"""When backups were made and proven, which metrics show."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0012_backups"
down_revision = "0011_least_readable"
least_readable = 10


def upgrade() -> None:
    op.create_table(
        "backups",
        sa.Column("name", sa.String(32), primary_key=True),
        sa.Column("made", sa.Double, nullable=False),
        sa.Column("proven", sa.Double),
    )
