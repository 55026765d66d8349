"""`capture2vr backup drill`: restore a backup to a place of its own, compare it with what was saved, and remove it."""

from __future__ import annotations

import fcntl
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from capture2vr.cli.backups import sealed_keys
from capture2vr.cli.backups.backup_faults import database_errors, record
from capture2vr.cli.backups.backup_folder import DATABASE, KEYS, Backup, listed, open_backup
from capture2vr.cli.local_settings import check_data, local_settings, local_store
from capture2vr.cli.progress import console, warn
from capture2vr.errors import BadInput
from capture2vr.gateway.backup.database_copy import check_importable, import_database, lost_rows
from capture2vr.gateway.backup.scrub import Scrub
from capture2vr.gateway.backup.trial import TrialUnderWay, trial_database, trial_folder, trial_store
from capture2vr.gateway.settings import GatewaySettings
from capture2vr.storage.local import LocalStore
from capture2vr.storage.object_backup import compare, restore_objects, unexpected_objects
from capture2vr.storage.store import Store

_ROOM = 64 << 20  # bytes that stay free on the disk while a drill is under way
_UNPACKED = 8  # a database of SQLite takes at most so many times the bytes of its packed rows


def drill_backup(folder: Path, name: str, data: Path) -> bool:
    """Restore a backup beside the service, compare, remove all of it, and return whether the backup is good.

    Raises BadInput, OSError.
    """
    check_data(data)
    began = time.monotonic()
    backup = open_backup(folder, name)
    if faults := list(backup.faults()):
        raise BadInput(f"the backup is damaged, and nothing was tried: {listed(faults)}")
    settings, store = local_settings(data), local_store(data)
    _try_keys(backup)
    unseal = sealed_keys.unsealer(backup.manifest.sealed)
    with _only_one(settings), trial_folder(settings.data_dir / "drill") as place:
        _check_room(backup, store, place)
        found = [*_try_database(settings, backup, place, unseal), *_try_store(store, backup, place)]
    for fault in found:
        console.print(f"not as in the backup: {fault}", markup=False)
    if found:
        return False
    record(settings, lambda records: records.prove(backup.folder.name, backup.manifest.made_at, time.time()))
    seconds = time.monotonic() - began
    console.print(f"backup {backup.folder.name} was restored in {seconds:.1f} s, is whole, and was removed again")
    return True


def _try_keys(backup: Backup) -> None:
    if not backup.has_keys:
        warn("there are no keys in this backup: make it with --keys, or keep them elsewhere")
        return
    keys = sealed_keys.unseal((backup.folder / KEYS).read_bytes(), sealed_keys.passphrase())
    console.print(f"keys: {len(keys):,} files were decrypted")


def _try_database(
    settings: GatewaySettings, backup: Backup, place: Path, unseal: Callable[[str], str] | None
) -> Iterator[str]:
    """Restore the database to another one; yield what is not as in the backup."""
    source, schema = backup.folder / DATABASE, backup.manifest.schema
    try:
        with database_errors(settings, "cannot be tried on"), trial_database(settings.database, place) as url:
            check_importable(url, schema)
            done = import_database(url, source, schema, unseal)
            if done.rows != backup.manifest.rows:
                yield f"{done.rows:,} of {backup.manifest.rows:,} rows were restored"
            yield from lost_rows(url, source)
    except TrialUnderWay as error:
        raise BadInput(str(error)) from None
    console.print(f"database: {done.rows:,} rows were restored and counted")


def _try_store(store: Store, backup: Backup, place: Path) -> Iterator[str]:
    """Restore the objects to another store, and read them back; yield the names of those that are others."""
    inventory = backup.inventory()
    if not backup.manifest.copied:
        warn("this backup has no contents of objects: the store itself was compared with its list")
        found = compare(store, inventory)
        yield from (*found.missing, *found.changed)
        return
    with trial_store(store, place) as trial:
        written = restore_objects(trial, backup.contents, inventory)
        if written != len(inventory):
            yield f"{written:,} of {len(inventory):,} objects were restored"
        yield from unexpected_objects(trial, inventory)
        scrub = Scrub(trial, place / "scrub.json", 0)
        for _ in scrub.steps():
            pass
        yield from scrub.state.damaged
    console.print(f"store: {written:,} objects were restored and compared, {scrub.state.checked:,} files were scrubbed")


def _check_room(backup: Backup, store: Store, place: Path) -> None:
    """Raises BadInput where the disk has no room for what is restored to it."""
    needed = _ROOM + _UNPACKED * (backup.folder / DATABASE).stat().st_size
    if isinstance(store, LocalStore) and backup.manifest.copied:
        needed += backup.manifest.bytes
    if (free := shutil.disk_usage(place).free) < needed:
        raise BadInput(
            f"{place.parent}: {free / 1e6:,.0f} MB are free, and the drill needs {needed / 1e6:,.0f} MB there for its "
            "copy: free some space, or set GATEWAY_DATA_DIR to a folder on another disk"
        )


@contextmanager
def _only_one(settings: GatewaySettings) -> Iterator[None]:
    """Lock the data folder against a second drill; gateways may go on. Raises BadInput."""
    with (settings.data_dir / "drill.lock").open("a") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise BadInput(f"{settings.data_dir}: another drill is under way; wait until it has ended") from None
        yield
