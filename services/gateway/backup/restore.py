"""Restore a damaged SQLite database: the newest whole snapshot, rows that can be read, jobs that the store tells of.

The new database is built beside the damaged file, and then takes its place; the damaged file is kept.
"""

from __future__ import annotations

import json
import re
import shutil
import sqlite3
import time
from collections.abc import Iterator
from contextlib import closing, suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from pathlib import Path
from typing import Any

import sqlalchemy as sa

from capture2vr.gateway.backup.snapshots import NAME_TIME, DatabaseDamaged, check_file, snapshots_in
from capture2vr.gateway.database.database import for_writing, open_engine
from capture2vr.gateway.jobs.job import Job, Lease, Order, State
from capture2vr.gateway.jobs.job_counts import count_again
from capture2vr.gateway.jobs.row_mapping import job_values, lease_values
from capture2vr.gateway.jobs.tables import jobs, leases
from capture2vr.order.job_options import JobOptions
from capture2vr.process.atomic_write import sync
from capture2vr.storage.catalogue.entry import Entry, list_keys, read_entry
from capture2vr.storage.catalogue.faults import CatalogueFault
from capture2vr.storage.store import LAST, Store
from capture2vr.storage.tenant_store import DEFAULT_TENANT, FOLDER, store_of_tenant, valid_tenant

_BESIDE = ("", "-wal", "-shm", "-journal")  # suffixes of the files of one SQLite database
_ROWS_AT_ONCE = 64
_LEAST_ROW_BYTES = 40  # of any table
_NUMBER = "row number"  # no column is called so
_MOST_NUMBER = 1 << 62  # SQLite counts a little farther; a damaged page may say anything
_UNREADABLE = (sqlite3.DatabaseError, UnicodeDecodeError)  # the second where SQLite's message quotes damaged bytes
_MIGRATIONS = "alembic_version"
_COLUMNS = 'SELECT name, type, "notnull" FROM pragma_table_info(?)'


@dataclass(frozen=True, slots=True)
class _Column:
    """A column of a table."""

    name: str
    type: str
    required: bool

    def takes(self, value: Any) -> bool:
        """Validate a value that was read from a damaged database: return whether a gateway can have written it."""
        if value is None:
            return not self.required
        if self.type != "JSON":
            return True
        try:
            json.loads(value)
        except (ValueError, TypeError):
            return False
        return True


@dataclass(frozen=True, slots=True)
class Restored:
    """What a restored database was made of.

    snapshot  the newest whole one, or None
    kept      the damaged file, which rows were read from; None where there was none
    rows      number of rows that were read from the damaged file
    jobs      number of jobs that only the store told of
    """

    snapshot: Path | None
    kept: Path | None
    rows: int
    jobs: int


def restore(database: Path, snapshots: Path, store: Store) -> Restored:
    """Replace a database by the newest whole snapshot, what can be read of the old file, and what the store tells.

    The new one is built beside the old one, which stays in its place until then: a failure changes nothing, and the
    same call may be repeated. No gateway may run. Raises OSError, sqlite3.Error, sqlalchemy.exc.SQLAlchemyError.
    """
    fresh = database.with_name(f"{database.stem}-restoring{database.suffix}")
    snapshot = _newest_whole(snapshots)
    damaged = database if database.exists() else _set_aside_since(snapshot, database, fresh)
    _remove(fresh)  # of a restore that was killed
    try:
        rows, count = _build(fresh, snapshot, damaged, store)
    except BaseException:
        _remove(fresh)
        raise
    kept = _replace(database, fresh)
    return Restored(snapshot, kept if damaged == database else damaged, rows, count)


def _newest_whole(folder: Path) -> Path | None:
    for snapshot in snapshots_in(folder):
        with suppress(DatabaseDamaged):
            check_file(snapshot)
            return snapshot
    return None


def _set_aside_since(snapshot: Path | None, database: Path, fresh: Path) -> Path | None:
    """Return the newest damaged file that was set aside since the snapshot, None where there is none.

    A restore that was cut off between its two renames leaves it, the new file, and no database.
    """
    name = re.compile(rf"{re.escape(database.stem)}-damaged-\d{{8}}T\d{{6}}Z{re.escape(database.suffix)}")
    damaged = max((each for each in database.parent.iterdir() if name.fullmatch(each.name)), default=None)
    if damaged is None or (snapshot is not None and _time_in(damaged) < _time_in(snapshot)):
        return None  # a snapshot is taken of a database: so the restore of then had come to its end
    if fresh.exists():
        _rename(database, damaged)  # its log, which may not have come to be renamed
    return damaged


def _time_in(name: Path) -> str:
    return name.stem.rpartition("-")[2]


def _build(fresh: Path, snapshot: Path | None, damaged: Path | None, store: Store) -> tuple[int, int]:
    """Write the new database into one file, and sync it; return the numbers of rows and of jobs of `Restored`."""
    if snapshot is not None:
        shutil.copyfile(snapshot, fresh)
    engine = open_engine(f"sqlite:///{fresh.absolute()}")
    try:
        rows = _salvage(damaged, fresh) if damaged is not None else 0
        _complete_leases(engine)
        count = _rebuild_jobs(engine, store)
        with for_writing(engine).begin() as db:
            count_again(db)  # no trigger hears of a row that takes another one's place
    finally:
        engine.dispose()
    with closing(sqlite3.connect(fresh)) as db:
        db.execute("PRAGMA journal_mode = DELETE")  # without a log, so that one rename moves all of it
    sync(fresh)
    return rows, count


def _replace(database: Path, fresh: Path) -> Path:
    """Put the new file in the place of a database; return the name under which the old one is kept."""
    at = datetime.now(UTC)
    while (kept := database.with_name(f"{database.stem}-damaged-{at:{NAME_TIME}}{database.suffix}")).exists():
        at += timedelta(seconds=1)
    _rename(database, kept)
    sync(database.parent)
    # A crash before the next line leaves no database: a restore then finds the old one by `_set_aside_since`.
    fresh.rename(database)
    sync(database.parent)
    return kept


def _rename(database: Path, name: Path) -> None:
    """Rename a database's files that are there. Its log comes after it: a crash leaves no database without its log."""
    for suffix in _BESIDE:
        with suppress(FileNotFoundError):
            database.with_name(database.name + suffix).rename(name.with_name(name.name + suffix))


def _remove(database: Path) -> None:
    for suffix in _BESIDE:
        database.with_name(database.name + suffix).unlink(missing_ok=True)


def _salvage(damaged: Path, database: Path) -> int:
    """Copy the rows of a damaged database that can be read and are whole; return how many."""
    with (
        closing(sqlite3.connect(damaged)) as source,
        closing(sqlite3.connect(database, isolation_level=None)) as target,
    ):
        source.row_factory = sqlite3.Row
        target.execute("BEGIN")
        space = damaged.stat().st_size // _LEAST_ROW_BYTES
        count = sum(_copy(source, target, table, columns, space) for table, columns in _tables(target).items())
        for table, row, *_ in target.execute("PRAGMA foreign_key_check").fetchall():
            target.execute(f'DELETE FROM "{table}" WHERE rowid = ?', (row,))  # noqa: S608 - a name from our own schema
        target.execute("COMMIT")
    return count


def _tables(database: sqlite3.Connection) -> dict[str, list[_Column]]:
    """Return the columns of each table, but for the one of the migrations."""
    names = database.execute("SELECT name FROM sqlite_master WHERE type = 'table' AND name NOT LIKE 'sqlite_%'")
    return {
        name: [_Column(*row) for row in database.execute(_COLUMNS, (name,))]
        for (name,) in names.fetchall()
        if name != _MIGRATIONS
    }


def _copy(
    source: sqlite3.Connection, target: sqlite3.Connection, table: str, columns: list[_Column], space: int
) -> int:
    """Copy the rows of a table that are whole. They are newer than the snapshot's, which they replace."""
    count = 0
    for row in _rows(source, table, space):
        present = [column for column in columns if column.name in row.keys()]  # noqa: SIM118 - not of a mapping
        if all(column.takes(row[column.name]) for column in present):
            names, marks = ", ".join(f'"{column.name}"' for column in present), ", ".join("?" * len(present))
            statement = f'INSERT OR REPLACE INTO "{table}" ({names}) VALUES ({marks})'  # noqa: S608 - our own schema
            with suppress(sqlite3.IntegrityError):
                count += target.execute(statement, [row[column.name] for column in present]).rowcount
    return count


def _rows(source: sqlite3.Connection, table: str, space: int) -> Iterator[sqlite3.Row]:
    """Yield the rows of a table that can be read; a page that cannot hides only its own.

    Row numbers begin and end anywhere: those of deleted rows are not given again.

    space  most rows that the file can hold: the row numbers that are tried where nothing can be read
    """
    try:
        _from(source, table, 0, 0)
    except _UNREADABLE:
        return  # the table's own description is damaged: no row of it can be read
    first, left = 0, space
    while left > 0 and first < _MOST_NUMBER:
        try:
            found = _from(source, table, first, _ROWS_AT_ONCE)
        except _UNREADABLE:
            first = _next(source, table, first)
            found = [row for number in range(first, first + _ROWS_AT_ONCE) for row in _one(source, table, number)]
            first, left = first + _ROWS_AT_ONCE, space if found else left - _ROWS_AT_ONCE
        else:
            if not found:
                return
            first, left = found[-1][_NUMBER] + 1, space
        yield from found


def _next(source: sqlite3.Connection, table: str, first: int) -> int:
    """Return the number of the next row from `first` on; `first` where it cannot be read."""
    with suppress(*_UNREADABLE):
        if found := _from(source, table, first, 1):
            return int(found[0][_NUMBER])
    return first


def _one(source: sqlite3.Connection, table: str, number: int) -> list[sqlite3.Row]:
    with suppress(*_UNREADABLE):
        return [row for row in _from(source, table, number, 1) if row[_NUMBER] == number]
    return []


def _from(source: sqlite3.Connection, table: str, first: int, most: int) -> list[sqlite3.Row]:
    """Return at most so many rows, from this row number on. Raises one of _UNREADABLE."""
    query = f'SELECT *, rowid AS "{_NUMBER}" FROM "{table}" WHERE rowid >= ? ORDER BY rowid LIMIT ?'  # noqa: S608 - ours
    found = source.execute(query, (first, most)).fetchall()
    numbers = [first - 1, *(row[_NUMBER] for row in found)]
    if any(before >= after for before, after in pairwise(numbers)):
        raise sqlite3.DatabaseError("a page is damaged: its rows are not in order")
    return found


def _complete_leases(engine: sa.Engine) -> None:
    """Give each job whose lease was lost a new one, with a fencing token above all that workers have seen."""
    with for_writing(engine).begin() as db:
        without = db.execute(sa.select(jobs.c.id).where(jobs.c.id.not_in(sa.select(leases.c.job)))).scalars().all()
        lease = asdict(Lease(fence=int(time.time())))
        if without:
            db.execute(leases.insert(), [{"job": job, **lease} for job in without])


def _rebuild_jobs(engine: sa.Engine, store: Store) -> int:
    """Add a finished job for each published version whose job the database does not know; return how many."""
    count = 0
    with for_writing(engine).begin() as db:
        known = set(db.execute(sa.select(jobs.c.id)).scalars())
        for tenant in _tenants(store):
            for job in _published_jobs(store_of_tenant(store, tenant), tenant):
                if job.id not in known:
                    known.add(job.id)
                    db.execute(jobs.insert().values(job_values(job)))
                    db.execute(leases.insert().values(lease_values(job)))
                    count += 1
    return count


def _tenants(store: Store) -> Iterator[str]:
    """Yield the tenants that have objects on the store, the default one first."""
    yield DEFAULT_TENANT
    after = FOLDER
    while heads := store.list(FOLDER, after=after, limit=1):
        name = heads[0].name.removeprefix(FOLDER).partition("/")[0]
        if valid_tenant(name) and name != DEFAULT_TENANT:
            yield name
        after = f"{FOLDER}{name}{LAST}"


def _published_jobs(store: Store, tenant: str) -> Iterator[Job]:
    after = ""
    while keys := list_keys(store, after=after):
        for key in keys:
            with suppress(FileNotFoundError, CatalogueFault):
                yield from _jobs_of(read_entry(store, key), tenant)
        after = keys[-1]


def _jobs_of(entry: Entry, tenant: str) -> Iterator[Job]:
    """Yield the jobs that published versions of an asset, as far as the store knows them; of each its last version."""
    updated = datetime.fromisoformat(str(entry.document["updated"])).timestamp()
    collection = entry.collections[0]
    for version in {each["job"]: each for each in entry.versions if each.get("job")}.values():
        asset = {
            "key": entry.key,
            "version": version["version"],
            "state": version["state"],
            "manifest": version["manifest"],
            "collection": collection,
            "held": bool(version.get("held")),
        }
        order = Order("", entry.key, JobOptions(collection=collection))
        yield Job(
            id=str(version["job"]),
            order=order,
            created=min(updated, _created(str(version["job"]), updated)),
            updated=updated,
            state=State.SUCCEEDED,
            fraction=1.0,
            asset=asset,
            tenant=tenant,
        )


def _created(job: str, otherwise: float) -> float:
    """Return the time in a job's id, in seconds since the epoch."""
    try:
        created = int(job.removeprefix("job_")[:12], 16) / 1000
    except ValueError:
        return otherwise
    return created if 0 < created < time.time() else otherwise
