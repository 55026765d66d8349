"""Numbers of jobs by state, kept by triggers; and which jobs have ended lately.

The triggers count what gateways of before change, too. A later migration that copies the table `jobs` (batch mode on
SQLite) drops them, and has to make them again.
"""

# ruff: noqa: S608 - names from this file alone

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0013_counters"
down_revision = "0012_backups"
least_readable = 10

_STATES = ("queued", "running", "cancelling", "succeeded", "failed", "cancelled")
_ENDED = "('SUCCEEDED', 'FAILED', 'CANCELLED')"
# One row would be a queue for all gateways: each transaction would wait for the one before it, or lock the other way
# round. A connection has a row of its own, and their sum counts.
_POSTGRES_SLOTS = 64


def upgrade() -> None:
    op.create_table(
        "job_counts",
        sa.Column("slot", sa.Integer, primary_key=True, autoincrement=False),
        *(sa.Column(state, sa.BigInteger, nullable=False, server_default=sa.text("0")) for state in _STATES),
    )
    op.create_table(
        "ended_jobs",
        # No foreign key: a gateway of before deletes jobs without knowing this table.
        sa.Column("job", sa.String(64), primary_key=True),
        sa.Column("ended", sa.Double, nullable=False, index=True),
    )
    on_postgres = op.get_bind().dialect.name == "postgresql"
    if on_postgres:
        op.execute("LOCK TABLE jobs IN SHARE ROW EXCLUSIVE MODE")  # else what others write meanwhile is not counted
    counts = ", ".join(f"COALESCE(SUM(CASE state WHEN '{state.upper()}' THEN 1 ELSE 0 END), 0)" for state in _STATES)
    op.execute(f"INSERT INTO job_counts (slot, {', '.join(_STATES)}) SELECT 0, {counts} FROM jobs")
    for statement in _POSTGRES if on_postgres else _SQLITE:
        op.execute(statement)


def _moved(row: str, sign: str) -> str:
    """Return the assignments that count a row's state, or count it no longer."""
    return ", ".join(f"{state} = {state} {sign} ({row}.state = '{state.upper()}')" for state in _STATES)


def _sum(source: str) -> str:
    return ", ".join(f"COUNT(*) FILTER (WHERE state = '{state.upper()}') AS {state}" for state in _STATES) + source


_CHANGED = ", ".join(
    f"{state} = {state} + (NEW.state = '{state.upper()}') - (OLD.state = '{state.upper()}')" for state in _STATES
)
_SQLITE = [
    f"CREATE TRIGGER jobs_added AFTER INSERT ON jobs BEGIN UPDATE job_counts SET {_moved('NEW', '+')}; END",
    f"CREATE TRIGGER jobs_deleted AFTER DELETE ON jobs BEGIN UPDATE job_counts SET {_moved('OLD', '-')}; END",
    "CREATE TRIGGER jobs_changed AFTER UPDATE OF state ON jobs WHEN OLD.state <> NEW.state "
    f"BEGIN UPDATE job_counts SET {_CHANGED}; END",
    f"CREATE TRIGGER jobs_ended AFTER UPDATE OF state ON jobs WHEN OLD.state <> NEW.state AND NEW.state IN {_ENDED} "
    "BEGIN INSERT OR REPLACE INTO ended_jobs (job, ended) VALUES (NEW.id, NEW.updated); END",
]

_COLUMNS = ", ".join(_STATES)
_ADDED = ", ".join(f"{state} = counted.{state} + EXCLUDED.{state}" for state in _STATES)
_UPSERT = f"ON CONFLICT (slot) DO UPDATE SET {_ADDED}"
_INSERT = f"INSERT INTO job_counts AS counted (slot, {_COLUMNS}) SELECT pg_backend_pid() % {_POSTGRES_SLOTS}"
_PLUS = ", ".join(f"n.{state}" for state in _STATES)
_MINUS = ", ".join(f"-n.{state}" for state in _STATES)
_ROW = ", ".join(f"(NEW.state = '{state.upper()}')::int - (OLD.state = '{state.upper()}')::int" for state in _STATES)
_POSTGRES = [
    "CREATE OR REPLACE FUNCTION count_added_jobs() RETURNS trigger AS $$ BEGIN "
    f"{_INSERT}, {_PLUS} FROM (SELECT {_sum(' FROM added')}) n {_UPSERT}; RETURN NULL; END $$ LANGUAGE plpgsql",
    "CREATE OR REPLACE FUNCTION count_deleted_jobs() RETURNS trigger AS $$ BEGIN "
    f"{_INSERT}, {_MINUS} FROM (SELECT {_sum(' FROM deleted')}) n {_UPSERT}; RETURN NULL; END $$ LANGUAGE plpgsql",
    "CREATE OR REPLACE FUNCTION count_changed_job() RETURNS trigger AS $$ BEGIN "
    f"{_INSERT}, {_ROW} {_UPSERT}; "
    f"IF NEW.state IN {_ENDED} THEN INSERT INTO ended_jobs (job, ended) VALUES (NEW.id, NEW.updated) "
    "ON CONFLICT (job) DO UPDATE SET ended = EXCLUDED.ended; END IF; RETURN NULL; END $$ LANGUAGE plpgsql",
    "CREATE TRIGGER jobs_added AFTER INSERT ON jobs REFERENCING NEW TABLE AS added "
    "FOR EACH STATEMENT EXECUTE FUNCTION count_added_jobs()",
    "CREATE TRIGGER jobs_deleted AFTER DELETE ON jobs REFERENCING OLD TABLE AS deleted "
    "FOR EACH STATEMENT EXECUTE FUNCTION count_deleted_jobs()",
    "CREATE TRIGGER jobs_changed AFTER UPDATE OF state ON jobs FOR EACH ROW "
    "WHEN (OLD.state IS DISTINCT FROM NEW.state) EXECUTE FUNCTION count_changed_job()",
]
