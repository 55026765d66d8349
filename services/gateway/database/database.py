"""The gateway's SQL database: its engine, and how statements reach it. A commit survives a power cut.

SQLite by default: a write-ahead log, so that readers never wait for the writer; every commit is synced; writers lock at
BEGIN, because a transaction that reads first and writes later fails at once instead of waiting for the lock.
"""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.engine import Connection, Engine

from capture2vr.gateway.database.schema import migrate

metadata = sa.MetaData()
"""All tables of the gateway; a test compares them with what the migrations make."""

_CHECK_MS = 1_000  # wait of a health check
_POSTGRES = {
    "client_encoding": "utf8",  # whatever PGCLIENTENCODING says
    "connect_timeout": "5",
    # A server that vanished without a word is noticed after 15 s instead of a quarter of an hour.
    "keepalives_idle": "5",
    "keepalives_interval": "5",
    "keepalives_count": "2",
    "tcp_user_timeout": "15000",
}
_AGAIN_S = 0.01  # between two tries where SQLite refuses without waiting
_BUSY_MS = 10_000  # wait for the lock: other processes hold it for a synced commit; longer than 10 s is a fault


def open_engine(url: str) -> Engine:
    """Open the database and bring its schema up to date.

    Raises sqlalchemy.exc.SQLAlchemyError when it cannot be used: SchemaNewer for one of a newer gateway that this one
    cannot work with, WrongEncoding.
    """
    engine = create_engine(url)
    try:
        check_encoding(engine)
        migrate(engine, for_writing(engine))
    except BaseException:
        engine.dispose()
        raise
    return engine


def create_engine(url: str) -> Engine:
    """Return the engine of a database, which connects at first use; its schema is left as it is."""
    # psycopg would prepare statements after some uses, and Postgres then plan them for no state of a job in particular.
    options = {} if url.startswith("sqlite") else {"prepare_threshold": None}
    engine = sa.create_engine(_completed(url), pool_pre_ping=not url.startswith("sqlite"), connect_args=options)
    if engine.dialect.name == "sqlite":
        sa.event.listen(engine, "connect", _prepare)
        sa.event.listen(engine, "begin", _begin)
    return engine


def _completed(url: str) -> sa.URL:
    """Return a database's URL with the driver and the timeouts that the gateway uses, where it names none."""
    parsed = sa.make_url(url)
    if parsed.drivername in ("postgres", "postgresql"):
        parsed = parsed.set(drivername="postgresql+psycopg")
    if parsed.get_backend_name() == "postgresql":
        parsed = parsed.set(query={**_POSTGRES, **parsed.query})
    return parsed


class WrongEncoding(sa.exc.SQLAlchemyError):
    """The database cannot store all text."""


def check_encoding(engine: Engine) -> None:
    """Raises WrongEncoding for a Postgres database that is not in UTF-8: it returns text as bytes, or refuses it."""
    if engine.dialect.name != "postgresql":
        return
    with engine.connect() as db:
        encoding = db.execute(sa.text("SHOW server_encoding")).scalar_one()
    if encoding != "UTF8":
        raise WrongEncoding(
            f"the jobs database '{engine.url.database}' has the encoding {encoding}, and names are stored in UTF-8: "
            "make another with CREATE DATABASE name ENCODING 'UTF8' TEMPLATE template0, and name it in "
            "GATEWAY_DATABASE_URL"
        )


def for_writing(engine: Engine) -> Engine:
    """Return the engine with transactions that take SQLite's write lock at BEGIN."""
    return engine.execution_options(writes=True)


def upsert(db: Connection, table: sa.Table, key: Mapping[str, Any], values: Mapping[str, Any]) -> None:
    """Insert a row, or update the one with this primary key, in one statement: another process may do so just now."""
    insert = postgresql.insert if db.dialect.name == "postgresql" else sqlite.insert
    row = insert(table).values({**key, **values})
    db.execute(row.on_conflict_do_update(index_elements=list(key), set_=dict(values)))


def insert_if_absent(db: Connection, table: sa.Table, values: Mapping[str, Any]) -> None:
    """Insert a row unless there is one with its primary key."""
    insert = postgresql.insert if db.dialect.name == "postgresql" else sqlite.insert
    db.execute(insert(table).values(dict(values)).on_conflict_do_nothing())


@contextmanager
def pipelined(db: Connection) -> Iterator[None]:
    """Send the block's statements to Postgres without waiting for the answer to each: one round trip for all of them.

    Only for statements whose rows and counts nobody reads. Other databases have no round trips.
    Raises sqlalchemy.exc.DBAPIError at the end of the block for what a statement is refused for.
    """
    if db.dialect.name != "postgresql":
        yield
        return
    import psycopg  # Here, because it is installed only where the database is Postgres.

    raw: Any = db.connection.dbapi_connection
    try:
        with raw.pipeline():
            yield
    except BaseException as error:
        with suppress(psycopg.Error):  # SQLAlchemy rolls nothing back where COMMIT failed, which here was not reached
            raw.rollback()
        if isinstance(error, psycopg.Error):
            raise sa.exc.DBAPIError.instance(None, None, error, psycopg.Error, dialect=db.dialect) from error
        raise


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
    cursor.execute(f"PRAGMA busy_timeout={_BUSY_MS}")
    _write_ahead(cursor)
    for pragma in ("synchronous=FULL", "foreign_keys=ON"):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()


def _write_ahead(cursor: Any) -> None:
    """Let a database have a write-ahead log. Where several gateways do so at once, SQLite refuses without waiting."""
    until = time.monotonic() + _BUSY_MS / 1000
    while True:
        try:
            cursor.execute("PRAGMA journal_mode=WAL")
        except sqlite3.OperationalError as error:
            is_busy = error.sqlite_errorcode & 0xFF in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED)
            if not is_busy or time.monotonic() > until:
                raise
            time.sleep(_AGAIN_S)
        else:
            return


def _begin(connection: Connection) -> None:
    writes = connection.get_execution_options().get("writes", False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")
