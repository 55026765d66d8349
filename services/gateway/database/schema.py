"""The schema of the gateway's database: its migrations (Alembic), and which gateways work with it.

Migrations expand: a gateway of the release before goes on beside the newer ones, and can be gone back to. What a
migration takes away, no gateway of the release before uses any more. So each states, as `least_readable`, the number of
the oldest schema whose gateways work with the database that it leaves; the database keeps it beside its revision. A
gateway that finds a newer schema starts where its own number is not below that.
"""

from __future__ import annotations

import logging
import sqlite3
import time
from functools import cache
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Connection, Engine

TABLE = "alembic_version"
"""Table of the schema's revision."""

_MIGRATIONS = Path(__file__).parents[1] / "migrations"
_FIRST = "0001"  # the schema of databases that are older than the migrations
_LOCK = 0x63327672  # Postgres: key of the lock that one gateway holds while it migrates; any number, only ours
_LEAST = "least_readable"  # column of TABLE, and name in a migration's module
_SINCE = 11  # number of the migration from which on there is that column, and each module states it
# Postgres: how long a migration waits for a table. While it waits, all others who want that table wait behind it.
_TABLE_LOCK = "2s"
_AGAIN_S = 1.0  # between two tries for a table that others use

_log = logging.getLogger(__name__)


class SchemaNewer(sa.exc.SQLAlchemyError):
    """The database was migrated by a newer version, in a way that this version cannot work with."""


def newest_schema() -> str:
    """Return the revision of the schema that this version works with."""
    return str(_scripts().get_current_head())


def schema_of(db: Connection) -> str | None:
    """Return the revision of a database's schema; None where it has none, or one of before the migrations."""
    from alembic.runtime.migration import MigrationContext

    return MigrationContext.configure(db).get_current_revision()


def is_known_schema(revision: str) -> bool:
    """Return whether this version knows a revision of the schema; else the revision is of a newer version."""
    return revision in _revisions()


def least_readable(db: Connection) -> int | None:
    """Return the number of the oldest schema whose gateways work with a database; None where it does not say."""
    if _LEAST not in {column["name"] for column in sa.inspect(db).get_columns(TABLE)}:
        return None
    found: int | None = db.execute(sa.text(f"SELECT {_LEAST} FROM {TABLE}")).scalar_one()  # noqa: S608 - our own names
    return found


def migrate(reader: Engine, writer: Engine) -> list[str]:
    """Run the migrations that a database lacks, each in a transaction of its own; return their revisions.

    Several gateways may do so at once. A database of a newer version that this one works with is left alone.

    reader, writer  engines of the same database; the writer's transactions lock SQLite at BEGIN
    Raises SchemaNewer, sqlalchemy.exc.SQLAlchemyError.
    """
    with reader.connect() as db, db.begin():
        if _is_ready(db):
            return []
    done: list[str] = []
    while revision := _patiently_migrate_once(writer):
        _log.info("the jobs database has schema %s now", revision)
        done.append(revision)
    return done


def upgrade(db: Connection, revision: str) -> None:
    """Run the migrations up to a revision that this database lacks, in the present transaction. Raises SchemaNewer."""
    from alembic.config import Config
    from alembic.runtime.environment import EnvironmentContext
    from alembic.runtime.migration import MigrationContext
    from alembic.util.exc import CommandError

    scripts, present = _scripts(), schema_of(db)
    if present is None and sa.inspect(db).has_table("jobs"):
        MigrationContext.configure(db).stamp(scripts, _FIRST)
        present = _FIRST
    try:
        steps = scripts._upgrade_revs(revision, present)
    except CommandError:
        raise _newer(str(present), None) from None
    with EnvironmentContext(Config(), scripts, fn=lambda *_: steps) as environment:
        environment.configure(connection=db)
        environment.run_migrations()
    if number_of(revision) >= _SINCE:
        least = max(int(getattr(each.module, _LEAST, 0)) for each in scripts.iterate_revisions(revision, "base"))
        db.execute(sa.text(f"UPDATE {TABLE} SET {_LEAST} = :least"), {"least": least})  # noqa: S608 - our own names


def lock_schema(db: Connection) -> None:
    """Lock the schema against migrations by other gateways until the transaction ends. SQLite has one writer."""
    if db.dialect.name == "postgresql":
        db.execute(sa.text("SELECT pg_advisory_xact_lock(:key)"), {"key": _LOCK})


def number_of(revision: str) -> int:
    """Return the number of a schema, with which its revision begins; 0 where it has none."""
    digits = revision[:4]
    return int(digits) if digits.isascii() and digits.isdigit() else 0


def _is_ready(db: Connection) -> bool:
    """Return whether the database's schema is this version's, or a newer one that it works with. Raises SchemaNewer."""
    present, newest = schema_of(db), newest_schema()
    if present is None or is_known_schema(present):
        return present == newest
    least = least_readable(db)
    if least is None or number_of(newest) < least:
        raise _newer(present, least)
    _log.info("the jobs database has the schema %s of a newer gateway, with which this one (%s) works", present, newest)
    return True


def _patiently_migrate_once(writer: Engine) -> str:
    """Run the next migration, and return its revision; "" where there is none. Waits while others use its tables."""
    is_told = False
    while True:
        try:
            return _migrate_once(writer)
        except sa.exc.OperationalError as error:
            if not _is_in_use(error):
                raise
            if not is_told:
                _log.warning("the migration waits: others use the jobs database")
                is_told = True
        time.sleep(_AGAIN_S)


def _migrate_once(writer: Engine) -> str:
    with writer.connect() as db, db.begin():
        lock_schema(db)
        if _is_ready(db):  # another gateway was faster
            return ""
        if db.dialect.name == "postgresql":
            db.execute(sa.text(f"SET LOCAL lock_timeout = '{_TABLE_LOCK}'"))
        present, revisions = schema_of(db), _revisions()
        if present is None and sa.inspect(db).has_table("jobs"):
            present = _FIRST
        following = revisions[0 if present is None else revisions.index(present) + 1]
        upgrade(db, following)
        return following


def _is_in_use(error: sa.exc.OperationalError) -> bool:
    """Whether somebody else had what the migration wanted: a table of Postgres, or SQLite's lock."""
    if isinstance(error.orig, sqlite3.OperationalError):
        return error.orig.sqlite_errorcode & 0xFF in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED)
    return getattr(error.orig, "sqlstate", None) == "55P03"


def _newer(present: str, least: int | None) -> SchemaNewer:
    works = f", which works with {least:04} and above" if least else ""
    return SchemaNewer(
        f"the jobs database is of a newer gateway (schema {present}{works}), and this one is of {newest_schema()}: "
        "install that version, or restore the backup that was made before the upgrade"
    )


@cache
def _revisions() -> tuple[str, ...]:
    """Return all revisions, the oldest first."""
    return tuple(str(script.revision) for script in reversed(list(_scripts().walk_revisions())))


@cache
def _scripts() -> Any:
    # Here, because Alembic takes 0.2 s to import, and the command line imports this module for less.
    from alembic.script import ScriptDirectory

    return ScriptDirectory(str(_MIGRATIONS), version_locations=[str(_MIGRATIONS)])
