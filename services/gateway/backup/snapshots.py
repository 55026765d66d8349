"""Snapshots of the gateway's SQLite database: one a day, checked before and written whole; the newest are kept.

A database on Postgres is backed up with Postgres' own tools.
"""

from __future__ import annotations

import asyncio
import logging
import sqlite3
import time
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

from sqlalchemy.engine import make_url

from capture2vr.process.atomic_write import atomic_write

NAME_TIME = "%Y%m%dT%H%M%SZ"
"""How the names of snapshots, and of damaged databases that are kept, have the time in UTC."""
_LOOK_S = 600.0  # between two looks whether a snapshot is due
_EVERY_S = 86_400.0
_PREFIX, _SUFFIX = "gateway-", ".db"

_log = logging.getLogger(__name__)


class DatabaseDamaged(Exception):  # noqa: N818 - it reads as what it is
    """SQLite finds faults in the database's file. The message is the first of them."""


def sqlite_file(url: str) -> Path | None:
    """Return the file of a database; None where it is no SQLite file."""
    parsed = make_url(url)
    return Path(parsed.database) if parsed.get_backend_name() == "sqlite" and parsed.database else None


def snapshots_in(folder: Path) -> list[Path]:
    """Return the snapshots in a folder, the newest first."""
    return sorted(folder.glob(f"{_PREFIX}*{_SUFFIX}"), reverse=True)


def check_file(database: Path) -> None:
    """Run SQLite's integrity check on a database file. Raises DatabaseDamaged, OSError."""
    if not database.exists():
        raise FileNotFoundError(2, "No such file or directory", str(database))
    try:
        with closing(sqlite3.connect(f"file:{database}?mode=ro", uri=True)) as db:
            fault = db.execute("PRAGMA integrity_check(1)").fetchone()[0]
    except sqlite3.DatabaseError as error:
        raise DatabaseDamaged(str(error)) from None
    if fault != "ok":
        raise DatabaseDamaged(fault)


def take_snapshot(database: Path, folder: Path, keep: int, now: float) -> Path:
    """Check the database, write a snapshot of it, and delete all but the newest `keep`.

    Raises DatabaseDamaged, after which all older snapshots are kept; sqlite3.Error, OSError.
    """
    check_file(database)
    folder.mkdir(parents=True, exist_ok=True)
    snapshot = folder / f"{_PREFIX}{datetime.fromtimestamp(now, UTC):{NAME_TIME}}{_SUFFIX}"
    with atomic_write(snapshot) as part:
        part.unlink(missing_ok=True)  # of a run that was killed: SQLite writes only a new file
        with closing(sqlite3.connect(database, isolation_level=None)) as db:
            db.execute("VACUUM INTO ?", (str(part),))
    for old in snapshots_in(folder)[keep:]:
        old.unlink()
    return snapshot


class Snapshots:
    """Takes a snapshot a day.

    fault  what SQLite found wrong with the database the last time that it looked, or ""
    """

    def __init__(self, url: str, folder: Path, keep: int) -> None:
        """keep: number of snapshots; 0: none are taken"""
        self._database = sqlite_file(url) if keep else None
        self._folder, self._keep = folder, keep
        self.fault = ""

    @property
    def are_taken(self) -> bool:
        """Whether this gateway takes snapshots."""
        return self._database is not None

    @property
    def newest(self) -> float | None:
        """Seconds since the epoch of the newest snapshot, None where there is none."""
        return next((each.stat().st_mtime for each in snapshots_in(self._folder)), None)

    async def run(self) -> None:
        """Take a snapshot whenever the newest is a day old; goes on until it is cancelled."""
        while self._database is not None:
            await asyncio.to_thread(self.take_if_due, self._database)
            await asyncio.sleep(_LOOK_S)

    def take_if_due(self, database: Path) -> None:
        """Take a snapshot where the newest is a day old. Faults are logged, and damage is kept in `fault`."""
        now = time.time()
        if (newest := self.newest) is not None and now - newest < _EVERY_S:
            return
        try:
            take_snapshot(database, self._folder, self._keep, now)
        except DatabaseDamaged as damage:
            self.fault = str(damage)
            _log.critical(
                "the jobs database is damaged: %s; stop the gateway, run `capture2vr gateway restore`", damage
            )
        except (OSError, sqlite3.Error) as error:
            _log.error("no snapshot of the jobs database was taken: %s", error)
        else:
            self.fault = ""
