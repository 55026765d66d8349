"""Implementation of `capture2vr gateway migrate | check | restore | scrub`."""

from __future__ import annotations

import sqlite3
import tempfile
import time
from pathlib import Path

from sqlalchemy.exc import OperationalError, SQLAlchemyError

from capture2vr.cli.local_settings import check_data, local_settings, local_store
from capture2vr.cli.progress import console, warn
from capture2vr.errors import BadInput
from capture2vr.gateway.backup.restore import restore
from capture2vr.gateway.backup.scrub import Scrub
from capture2vr.gateway.backup.snapshots import DatabaseDamaged, check_file, snapshots_in, sqlite_file
from capture2vr.gateway.database.database import WrongEncoding, check_encoding, create_engine, for_writing
from capture2vr.gateway.database.instance_lock import FolderInUse, lock_instance
from capture2vr.gateway.database.schema import SchemaNewer, migrate, newest_schema
from capture2vr.gateway.settings import GatewaySettings
from capture2vr.process.private_files import private_folder

_AGAIN_S = 1.0  # between two tries to reach a database that is away


def migrate_database(data: Path, wait_s: float) -> None:
    """Bring the schema up to date, and print what was done; waits so long for a database that is away.

    Raises BadInput, OSError.
    """
    check_data(data)
    settings = local_settings(data)
    private_folder(settings.data_dir)  # an empty one gets its database
    deadline = time.monotonic() + wait_s
    while True:
        try:
            done = _migrate(settings.database)
            break
        except (SchemaNewer, WrongEncoding) as error:
            raise BadInput(str(error)) from None
        except SQLAlchemyError as error:
            if not isinstance(error, OperationalError) or time.monotonic() > deadline:
                reason = getattr(error, "orig", None) or error
                raise BadInput(f"the jobs database cannot be migrated: {reason}") from error
        time.sleep(_AGAIN_S)
    for revision in done:
        console.print(f"migrated to schema {revision}")
    if not done:
        console.print(f"there is nothing to migrate for this version, which is of schema {newest_schema()}")


def _migrate(url: str) -> list[str]:
    engine = create_engine(url)
    try:
        check_encoding(engine)
        return migrate(engine, for_writing(engine))
    finally:
        engine.dispose()


def check_database(data: Path) -> bool:
    """Check the database and its snapshots, print what was found, and return whether the database is whole.

    Raises BadInput.
    """
    check_data(data)
    settings = local_settings(data)
    database = _database(settings)
    whole = _say(database, "the database")
    for snapshot in snapshots_in(settings.snapshots_dir):
        _say(snapshot, "a snapshot")
    if not whole:
        console.print("stop the gateway and run `capture2vr gateway restore`")
    return whole


def restore_database(data: Path) -> None:
    """Restore the database, and print what it was made of. Raises BadInput."""
    check_data(data)
    settings = local_settings(data)
    database = _database(settings)
    try:
        with lock_instance(settings.data_dir):
            done = restore(database, settings.snapshots_dir, local_store(data))
    except FolderInUse as error:
        raise BadInput(str(error)) from None
    except (sqlite3.Error, SQLAlchemyError) as error:
        raise BadInput(
            f"{database} cannot be restored and stays as it is: {getattr(error, 'orig', None) or error}"
        ) from error
    source = (
        f"the snapshot {done.snapshot.name}" if done.snapshot else "an empty database, because there is no snapshot"
    )
    console.print(f"restored from {source}")
    if done.kept is not None:
        console.print(f"{done.rows:,} rows were read from the damaged file, which is kept as {done.kept.name}")
    console.print(f"{done.jobs:,} jobs were added that only the store told of")
    warn("what was deleted or revoked since the snapshot may be back: look at `capture2vr keys list`")


def scrub_store(data: Path) -> bool:
    """Check the hash of every file of every asset, print the damaged ones, and return whether all are whole.

    Raises BadInput, OSError.
    """
    check_data(data)
    with tempfile.TemporaryDirectory(prefix="scrub-") as folder:
        scrub = Scrub(local_store(data), Path(folder) / "scrub.json", 0)
        for _ in scrub.steps():
            pass
    for name in scrub.state.damaged:
        console.print(f"damaged: {name}", soft_wrap=True, markup=False)
    console.print(f"{scrub.state.checked:,} files were read, {len(scrub.state.damaged):,} are damaged")
    return not scrub.state.damaged


def _say(file: Path, what: str) -> bool:
    try:
        check_file(file)
    except DatabaseDamaged as damage:
        console.print(f"{what} {file} is damaged: {damage}", soft_wrap=True, markup=False)
        return False
    console.print(f"{what} {file} is whole", soft_wrap=True, markup=False)
    return True


def _database(settings: GatewaySettings) -> Path:
    database = sqlite_file(settings.database)
    if database is None:
        raise BadInput("the database is no SQLite file: use its own tools, such as pg_dump")
    return database
