"""Export the gateway's database to a file, and import it into an empty one, of SQLite or of Postgres.

The file is a zip with JSON lines for each table: the names of its columns, then its rows. Both are read from the
database itself, so that one of an older version can be exported; the import makes that version's schema, fills it, and
migrates it.
"""

from __future__ import annotations

import itertools
import json
import time
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Connection

from capture2vr.gateway.access.tables import tenants
from capture2vr.gateway.database.database import check_encoding, create_engine, for_writing
from capture2vr.gateway.database.schema import (
    TABLE,
    is_known_schema,
    lock_schema,
    newest_schema,
    schema_of,
    upgrade,
)
from capture2vr.gateway.jobs.job import State
from capture2vr.gateway.jobs.row_mapping import WHOLE_JOB, job_from_row
from capture2vr.gateway.jobs.state_machine import RUNNING_STATES, requeue_refused
from capture2vr.gateway.jobs.store import update_rows
from capture2vr.gateway.jobs.tables import jobs, leases
from capture2vr.gateway.resumable.tables import chunks, uploads
from capture2vr.storage.tenant_store import DEFAULT_TENANT

_ROWS_AT_ONCE = 500  # per statement
_COUNTED = "job_counts"  # by triggers, which count the jobs of a backup while they are inserted
_SUFFIX = ".jsonl"
# Tables that a gateway, or a backup, fills before anybody has used it.
_FILLED_AT_START = frozenset({TABLE, _COUNTED, "secrets", "usage", "backups"})
# Columns that whoever has a backup must not read: with them requests could be signed, and sessions made.
_SECRETS = {"secrets": ("value",), "webhooks": ("secret",)}
# Of Postgres' triggers; it is made with the tables, but outlives them.
_FUNCTION = "refuse_audit_change"


class DatabaseNotEmpty(Exception):  # noqa: N818 - it reads as what it is
    """The database has rows, which an import would mix with others. The message says how many in which tables."""


@dataclass(frozen=True, slots=True)
class Exported:
    """What was exported. schema: the revision of the database's schema; rows: their number in all tables"""

    schema: str
    rows: int


@dataclass(frozen=True, slots=True)
class Imported:
    """What was imported. rows: their number; queued: jobs that ran, and wait in the queue again"""

    rows: int
    queued: int


def export_database(url: str, out: Path, seal: Callable[[str], str] | None = None) -> Exported:
    """Write all rows of a database as of one moment to a file; gateways may go on meanwhile.

    seal  encrypts the secrets in it; None: they are written as they are
    Raises ValueError where the database has no schema yet, sqlalchemy.exc.SQLAlchemyError, OSError.
    """
    with _snapshot(url) as db:
        schema = schema_of(db)
        if schema is None:
            raise ValueError("the database has no tables of a gateway, or is of one before migrations: start it once")
        with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
            rows = sum(_write_table(db, table, archive, seal) for table in _tables(db) if table.name != _COUNTED)
    return Exported(schema, rows)


def check_importable(url: str, schema: str) -> None:
    """Raises DatabaseNotEmpty, ValueError for a schema of a newer version, sqlalchemy.exc.SQLAlchemyError."""
    if not is_known_schema(schema):
        raise ValueError(
            f"it is of a newer version of capture2vr (schema {schema}, and this one knows {newest_schema()}): "
            "install that version, and restore with it"
        )
    engine = create_engine(url)
    try:
        check_encoding(engine)
        with engine.connect() as db, db.begin():
            _check_empty(db)
    finally:
        engine.dispose()


def import_database(url: str, source: Path, schema: str, unseal: Callable[[str], str] | None = None) -> Imported:
    """Fill an empty database from a file of `export_database`, in one transaction: a crash leaves it empty.

    Jobs that ran are queued again, under a fencing token above all that the store has seen; uploads that had not ended
    are forgotten, as their parts are in no backup.
    unseal  decrypts the secrets in it; None: they are not encrypted
    Raises DatabaseNotEmpty, ValueError, sqlalchemy.exc.SQLAlchemyError, OSError.
    """
    engine = create_engine(url)
    try:
        with for_writing(engine).connect() as db, db.begin():
            lock_schema(db)
            _check_empty(db)
            _drop_tables(db)
            upgrade(db, schema)
            rows = _read_tables(db, source, unseal)
            upgrade(db, newest_schema())
            queued = _queue_again(db)
            _forget_unfinished_uploads(db)
        return Imported(rows, queued)
    finally:
        engine.dispose()


def lost_rows(url: str, source: Path) -> Iterator[str]:
    """Compare the rows of an imported database with its file by their number; yield the tables that lack some.

    Uploads that had not ended are forgotten by an import, and not counted. Jobs that are queued again have an event
    more.
    """
    engine = create_engine(url)
    try:
        with engine.connect() as db, zipfile.ZipFile(source) as archive:
            for table in _tables(db):
                name = table.name + _SUFFIX
                if name in archive.namelist() and table.name not in (uploads.name, chunks.name):
                    with archive.open(name) as file:
                        saved = sum(1 for _ in file) - 1  # the first line has the columns' names
                    found = db.execute(sa.select(sa.func.count()).select_from(table)).scalar_one()
                    if found < saved:
                        yield f"table {table.name}: {found:,} of {saved:,} rows"
    finally:
        engine.dispose()


@contextmanager
def _snapshot(url: str) -> Iterator[Connection]:
    """Connect to a database; every query sees it as it was at the first."""
    engine = create_engine(url)
    try:
        with engine.connect() as db:
            if db.dialect.name == "postgresql":
                db = db.execution_options(isolation_level="REPEATABLE READ", postgresql_readonly=True)
            with db.begin():  # SQLite's write-ahead log keeps a transaction's view anyway
                yield db
    finally:
        engine.dispose()


def _tables(db: Connection) -> list[sa.Table]:
    """Return the tables that the database has, those that others refer to first; not the one of the migrations."""
    found = sa.MetaData()
    found.reflect(db)
    return [table for table in found.sorted_tables if table.name != TABLE]


def _stored(table: sa.Table) -> list[sa.Column[Any]]:
    return [column for column in table.columns if column.computed is None]


def _write_table(db: Connection, table: sa.Table, archive: zipfile.ZipFile, seal: Callable[[str], str] | None) -> int:
    """Write a table as a file of the archive; return the number of its rows."""
    columns = _stored(table)
    convert = _converter(table, [column.name for column in columns], seal)
    # JSON is written as its text, which tells null from NULL.
    select = sa.select(*(sa.cast(each, sa.Text) if _is_json(each) else each for each in columns))
    count = 0
    with archive.open(table.name + _SUFFIX, "w", force_zip64=True) as file:
        file.write(_line([column.name for column in columns]))
        for row in db.execute(select.execution_options(yield_per=_ROWS_AT_ONCE)):
            file.write(_line(convert(list(row))))
            count += 1
    return count


def _converter(
    table: sa.Table, names: list[str], change: Callable[[str], str] | None
) -> Callable[[list[Any]], list[Any]]:
    """Return what changes the secrets in a row of a table, whose columns have these names."""
    places = [names.index(name) for name in _SECRETS.get(table.name, ()) if name in names] if change else []

    def convert(row: list[Any]) -> list[Any]:
        for place in places:
            if change and row[place] is not None:
                row[place] = change(row[place])
        return row

    return convert


def _line(values: list[Any]) -> bytes:
    return json.dumps(values, ensure_ascii=False, separators=(",", ":")).encode() + b"\n"


def _is_json(column: sa.Column[Any]) -> bool:
    return isinstance(column.type, sa.JSON)


def _check_empty(db: Connection) -> None:
    found = {}
    for table in _tables(db):
        if table.name not in _FILLED_AT_START:
            select = sa.select(sa.func.count()).select_from(table)
            if table.name == "tenants":  # the migrations make the default one
                select = select.where(table.c.name != DEFAULT_TENANT)
            found[table.name] = db.execute(select).scalar_one()
    if any(found.values()):
        listed = ", ".join(f"{count:,} in {name}" for name, count in found.items() if count)
        raise DatabaseNotEmpty(f"it has rows: {listed}")


def _drop_tables(db: Connection) -> None:
    """Drop the empty tables that a gateway's start has made: they may be of another version's schema."""
    if schema_of(db) is None:
        return
    for table in reversed(_tables(db)):
        table.drop(db)
    db.execute(sa.text(f"DROP TABLE {TABLE}"))
    if db.dialect.name == "postgresql":
        db.execute(sa.text(f"DROP FUNCTION IF EXISTS {_FUNCTION}"))


def _read_tables(db: Connection, source: Path, unseal: Callable[[str], str] | None) -> int:
    """Insert all rows of the archive; return how many. Raises ValueError for a table that the schema has not."""
    db.execute(tenants.delete())
    rows = 0
    with zipfile.ZipFile(source) as archive:
        left = {name.removesuffix(_SUFFIX) for name in archive.namelist()}
        for table in _tables(db):
            if table.name in left:
                left.remove(table.name)
                with archive.open(table.name + _SUFFIX) as file:
                    rows += _insert(db, table, map(json.loads, file), unseal)
    if left:
        raise ValueError(f"{source} has tables that its schema has not: {', '.join(sorted(left))}")
    return rows


def _insert(db: Connection, table: sa.Table, lines: Iterator[list[Any]], unseal: Callable[[str], str] | None) -> int:
    texts = {column.name for column in _stored(table) if _is_json(column)}
    for name in texts:
        table.c[name].type = sa.JSON(none_as_null=True)
    names: list[str] = next(lines)
    convert = _converter(table, names, unseal)
    count = 0
    while some := [
        {name: _value(cell, name in texts) for name, cell in zip(names, row, strict=True)}
        for row in map(convert, itertools.islice(lines, _ROWS_AT_ONCE))
    ]:
        db.execute(table.insert(), some)
        count += len(some)
    _move_sequence(db, table)
    return count


def _value(cell: Any, is_json: bool) -> Any:
    if not is_json or cell is None:
        return cell
    found = json.loads(cell)
    return sa.JSON.NULL if found is None else found


def _move_sequence(db: Connection, table: sa.Table) -> None:
    """Have Postgres count on from the highest number of a table that numbers its rows; SQLite does so by itself."""
    key = table.autoincrement_column
    if db.dialect.name != "postgresql" or key is None or not isinstance(key.type, sa.Integer):
        return
    sequence = sa.func.pg_get_serial_sequence(table.name, key.name)
    highest = sa.select(sa.func.max(key)).scalar_subquery()
    db.execute(sa.select(sa.func.setval(sequence, highest)))


def _queue_again(db: Connection) -> int:
    """Queue the jobs that ran, without counting an attempt; return how many. A job that was being cancelled is."""
    now, count = time.time(), 0  # what was published after the backup may carry a higher fence than the database knows
    waiting = sa.select(jobs.c.id).where(jobs.c.state.in_([state.value for state in (State.QUEUED, *RUNNING_STATES)]))
    db.execute(leases.update().where(leases.c.job.in_(waiting), leases.c.fence < int(now)).values(fence=int(now)))
    for row in db.execute(WHOLE_JOB.where(jobs.c.state.in_([state.value for state in RUNNING_STATES]))).all():
        change = requeue_refused(job_from_row(row), row.lease_fence, now=now, pause_s=0.0)
        update_rows(db, change)
        count += change.job.state is State.QUEUED
    return count


def _forget_unfinished_uploads(db: Connection) -> None:
    unfinished = sa.select(uploads.c.id).where(uploads.c.ended.is_(None))
    db.execute(chunks.delete().where(chunks.c.upload.in_(unfinished)))
    db.execute(uploads.delete().where(uploads.c.ended.is_(None)))
