"""Translate what goes wrong with a backup's folder, database or gateway into sentences that say what to do."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from sqlalchemy.exc import SQLAlchemyError

from capture2vr.cli.progress import warn
from capture2vr.errors import BadInput
from capture2vr.gateway.backup.backup_records import BackupRecords
from capture2vr.gateway.backup.database_copy import DatabaseNotEmpty
from capture2vr.gateway.backup.snapshots import sqlite_file
from capture2vr.gateway.database.database import create_engine
from capture2vr.gateway.database.full_disk import is_disk_full
from capture2vr.gateway.database.instance_lock import FolderInUse, lock_instance
from capture2vr.gateway.settings import GatewaySettings


@contextmanager
def named_if_full(folder: Path) -> Iterator[None]:
    """Name the folder where its disk is full: the error itself names no file. Raises BadInput."""
    try:
        yield
    except OSError as error:
        if not is_disk_full(error):
            raise
        raise BadInput(
            f"{folder}: {error.strerror}; no backup was made, and the older ones are whole: free some space, or remove "
            "old backups with `capture2vr backup prune`"
        ) from None


@contextmanager
def nobody_in(settings: GatewaySettings) -> Iterator[None]:
    """Lock the data folder against gateways. Raises BadInput if one is running."""
    try:
        with lock_instance(settings.data_dir):
            yield
    except FolderInUse as error:
        raise BadInput(str(error)) from None


@contextmanager
def database_errors(settings: GatewaySettings, what: str) -> Iterator[None]:
    """Translate errors of the database. Raises BadInput."""
    database = sqlite_file(settings.database) or "the database of GATEWAY_DATABASE_URL"
    try:
        yield
    except DatabaseNotEmpty as error:
        raise BadInput(f"{database} {what}, because {error}; name an empty one") from None
    except ValueError as error:
        raise BadInput(f"the backup {what} {database}: {error}") from None
    except SQLAlchemyError as error:
        raise BadInput(f"{database} {what}: {reason_of(error)}") from error


def reason_of(error: SQLAlchemyError) -> str:
    """Return the first line of what the database said."""
    return str(getattr(error, "orig", None) or error).strip().splitlines()[0]


def record(settings: GatewaySettings, note: Callable[[BackupRecords], None]) -> None:
    """Record a backup or a drill in the service's database, for the metrics of its gateways; warns where that fails.

    The database has not been migrated yet where an older gateway uses it.
    """
    engine = create_engine(settings.database)
    try:
        note(BackupRecords(engine))
    except SQLAlchemyError as error:
        warn(f"all went well, but could not be recorded for the metrics: {reason_of(error)}")
    finally:
        engine.dispose()
