"""An index in the order of the queue, with the preset as a column: a claim no longer reads all queued jobs."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0008_queue"
down_revision = "0007_shares"


def upgrade() -> None:
    # Generated, so that it is right also where a gateway of before, which does not know it, adds jobs.
    # SQLite can add only virtual ones.
    stored = op.get_bind().dialect.name == "postgresql"
    op.add_column("jobs", sa.Column("preset", sa.Text, sa.Computed("\"order\" ->> 'preset'", persisted=stored)))
    op.drop_index("ix_jobs_state", "jobs", if_exists=True)
    op.create_index("ix_jobs_queue", "jobs", ["state", "preset", "tenant", "id"])
