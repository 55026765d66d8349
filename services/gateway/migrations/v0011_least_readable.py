"""The schema states which gateways work with it, beside its revision."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0011_least_readable"
down_revision = "0010_longer_codes"
least_readable = 10


def upgrade() -> None:
    op.add_column("alembic_version", sa.Column("least_readable", sa.Integer))
