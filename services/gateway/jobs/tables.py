"""Database tables of the jobs, and the SQLAlchemy engine. A commit survives a power cut.

SQLite by default: a write-ahead log, so that readers never wait for the writer; every commit is synced; writers lock at
BEGIN, because a transaction that reads first and writes later fails at once instead of waiting for the lock.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Connection, Engine

metadata = sa.MetaData()

jobs = sa.Table(
    "jobs",
    metadata,
    # Ids begin with the time of creation, so their order is the order of the queue and of every listing.
    sa.Column("id", sa.String(64), primary_key=True),
    sa.Column("order", sa.JSON, nullable=False),
    sa.Column("state", sa.String(16), nullable=False, index=True),
    sa.Column("stage", sa.String(32), nullable=False),
    sa.Column("fraction", sa.Double, nullable=False),
    sa.Column("elapsed_s", sa.Double, nullable=False),
    sa.Column("eta_s", sa.Double, nullable=False),
    sa.Column("preview", sa.JSON),
    sa.Column("asset", sa.JSON),
    sa.Column("error", sa.JSON),
    sa.Column("warnings", sa.JSON, nullable=False),
    sa.Column("seconds", sa.JSON, nullable=False),
    sa.Column("last_event", sa.Integer, nullable=False),
    sa.Column("created", sa.Double, nullable=False),
    sa.Column("updated", sa.Double, nullable=False),
)

leases = sa.Table(
    "leases",
    metadata,
    sa.Column("job", sa.ForeignKey("jobs.id"), primary_key=True),
    sa.Column("holder", sa.String(64), nullable=False),
    sa.Column("worker", sa.String(255), nullable=False),
    sa.Column("fence", sa.BigInteger, nullable=False),
    sa.Column("attempts", sa.Integer, nullable=False),
    sa.Column("until", sa.Double, nullable=False),
    sa.Column("not_before", sa.Double, nullable=False),
    sa.Column("run_seq", sa.BigInteger, nullable=False),
    sa.Column("cancel", sa.Boolean, nullable=False),
)

events = sa.Table(
    "events",
    metadata,
    # One sequence for all jobs: a process finds what others wrote by querying ids above the last that it has seen.
    sa.Column("id", sa.Integer, primary_key=True, autoincrement=True),
    sa.Column("job", sa.ForeignKey("jobs.id"), nullable=False),
    sa.Column("seq", sa.Integer, nullable=False),
    sa.Column("kind", sa.String(16), nullable=False),
    sa.Column("at", sa.Double, nullable=False),
    sa.Column("data", sa.JSON, nullable=False),
    sa.UniqueConstraint("job", "seq"),
)

idempotency = sa.Table(
    "idempotency_keys",
    metadata,
    sa.Column("key", sa.String(255), primary_key=True),
    sa.Column("body_sha256", sa.String(64), nullable=False),
    sa.Column("job", sa.ForeignKey("jobs.id"), nullable=False),
)

_CHECK_MS = 1_000  # wait of a health check
_BUSY_MS = 10_000  # wait for the lock: other processes hold it for a synced commit; longer than 10 s is a fault


def open_engine(url: str) -> Engine:
    """Open the database and create missing tables. Raises sqlalchemy.exc.SQLAlchemyError when it cannot be used."""
    engine = sa.create_engine(url, pool_pre_ping=not url.startswith("sqlite"))
    if engine.dialect.name == "sqlite":
        sa.event.listen(engine, "connect", _prepare)
        sa.event.listen(engine, "begin", _begin)
    metadata.create_all(engine)
    return engine


def for_writing(engine: Engine) -> Engine:
    """Return the engine with transactions that take SQLite's write lock at BEGIN."""
    return engine.execution_options(writes=True)


@contextmanager
def brief_wait(db: Connection) -> Iterator[None]:
    """Wait only a moment for SQLite's lock, on this connection: whoever asks whether the database can be written."""
    if db.dialect.name != "sqlite":
        yield
        return
    raw: Any = db.connection.dbapi_connection
    raw.execute(f"PRAGMA busy_timeout={_CHECK_MS}")
    try:
        yield
    finally:
        raw.execute(f"PRAGMA busy_timeout={_BUSY_MS}")


def _prepare(connection: Any, _: Any) -> None:
    connection.isolation_level = None  # the driver must not begin transactions by itself: `_begin` does
    cursor = connection.cursor()
    for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON", f"busy_timeout={_BUSY_MS}"):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()


def _begin(connection: Connection) -> None:
    writes = connection.get_execution_options().get("writes", False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")
