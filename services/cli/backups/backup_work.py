"""Implementation of `capture2vr backup create | verify | prune | restore`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from sqlalchemy.exc import SQLAlchemyError

import capture2vr
from capture2vr.cli.backups import sealed_keys
from capture2vr.cli.backups.backup_faults import database_errors, named_if_full, nobody_in, reason_of, record
from capture2vr.cli.backups.backup_folder import (
    DATABASE,
    INVENTORY,
    KEYS,
    NAME_TIME,
    Backup,
    BackupRetention,
    backups_in,
    listed,
    lock_folder,
    new_backup,
    open_backup,
    read_or_warn,
    remove_old,
    write_inventory,
    write_manifest,
)
from capture2vr.cli.backups.sealed_keys import KeyFile
from capture2vr.cli.local_settings import check_data, local_settings, local_store
from capture2vr.cli.progress import console, warn
from capture2vr.errors import BadInput
from capture2vr.gateway.backup.database_copy import (
    Exported,
    check_importable,
    export_database,
    import_database,
)
from capture2vr.gateway.backup.snapshots import sqlite_file
from capture2vr.gateway.settings import GatewaySettings
from capture2vr.storage.object_backup import (
    StoredObject,
    compare,
    copy_objects,
    list_objects,
    restore_objects,
    unexpected_objects,
)
from capture2vr.storage.store import Store


def create_backup(folder: Path, data: Path, *, with_objects: bool, keys: Path | None, keep: BackupRetention) -> None:
    """Write a backup and print what it has. Raises BadInput, OSError.

    keys  folder of keys, or None: none are in the backup
    """
    check_data(data)
    sealed = sealed_keys.seal(sealed_keys.read_keys(keys), sealed_keys.passphrase()) if keys else b""
    seal_text = sealed_keys.sealer()
    settings, store = local_settings(data), local_store(data)
    now = datetime.now(UTC)
    with named_if_full(folder), lock_folder(folder):
        with new_backup(folder, f"{now:{NAME_TIME}}") as part:
            if sealed:
                (part / KEYS).write_bytes(sealed)
            # First: what the rows refer to was stored before them.
            exported = _export(settings.database, part / DATABASE, seal_text)
            objects = (
                list_objects(store) if not with_objects else copy_objects(store, folder / "objects", _known(folder))
            )
            inventory = write_inventory(part / INVENTORY, objects)
            size = sum(each.size for each in inventory)
            write_manifest(
                part,
                made=now.isoformat(timespec="seconds"),
                version=capture2vr.__version__,
                schema=exported.schema,
                rows=exported.rows,
                objects=len(inventory),
                bytes=size,
                copied=with_objects,
                sealed=seal_text("") if seal_text else "",
            )
        removed = remove_old(folder, keep, now)
    backup = open_backup(folder, "")
    record(settings, lambda records: records.add(backup.folder.name, backup.manifest.made_at))
    _print_backup(backup)
    if removed:
        console.print(f"{removed:,} older ones were removed")


def prune_backups(folder: Path, keep: BackupRetention) -> None:
    """Remove old backups, and print how many. Raises BadInput, OSError."""
    open_backup(folder, "")
    with lock_folder(folder):
        removed = remove_old(folder, keep, datetime.now(UTC))
    console.print(f"{removed:,} backups were removed, {len(backups_in(folder)):,} are kept")


def verify_backup(folder: Path, name: str) -> bool:
    """Check the hash of every file of a backup, print what is wrong, and return whether it is whole.

    Raises BadInput.
    """
    backup = open_backup(folder, name)
    faults = list(backup.faults())
    for fault in faults:
        console.print(f"damaged: {fault}", markup=False)
    if any(fault.startswith(str(backup.contents)) for fault in faults):
        console.print(
            f"delete the damaged files in {backup.contents}: the next `backup create --with-objects` copies what the "
            "store still has"
        )
    if not faults:
        _print_backup(backup)
        console.print("every file of it is whole")
    return not faults


@dataclass(frozen=True, slots=True)
class Parts:
    """Which parts of a backup to restore. keys: the folder to write them to; None: they are not restored"""

    database: bool
    objects: bool
    keys: Path | None


def restore_backup(folder: Path, name: str, data: Path, parts: Parts) -> bool:
    """Restore parts of a backup where there is nothing yet, and print what was done.

    Everything is checked before anything is written, and the database is written last, in one transaction: after a
    crash the same command does the rest.
    Returns whether the store has all that the backup says. Raises BadInput, OSError.
    """
    backup = open_backup(folder, name)
    if faults := list(backup.faults()):
        raise BadInput(f"the backup is damaged, and nothing was restored: {listed(faults)}")
    keys = _keys_of(backup, parts.keys) if parts.keys else {}
    unseal = sealed_keys.unsealer(backup.manifest.sealed) if parts.database else None
    is_whole = True
    if parts.database or parts.objects:
        is_whole = _restore_service(backup, data, parts, lambda: _write_keys(keys, parts.keys), unseal)
    else:  # neither a database nor a store need be there yet
        _write_keys(keys, parts.keys)
    if backup.has_keys and not parts.keys:
        warn("the keys of this backup were not restored: name an empty folder for them with --keys")
    return is_whole


def _restore_service(
    backup: Backup, data: Path, parts: Parts, write_keys: Callable[[], None], unseal: Callable[[str], str] | None
) -> bool:
    """Restore keys, objects and database, in this order; return whether the store has all that the backup says."""
    settings, store = local_settings(data), local_store(data)
    inventory = backup.inventory() if parts.objects else []
    with nobody_in(settings):
        if parts.database:
            _check_database(settings, backup)
        if parts.objects and backup.manifest.copied:
            _check_store(store, inventory)
        write_keys()
        is_whole = not parts.objects or _restore_objects(store, backup, inventory)
        if parts.database:
            _restore_database(settings, backup, unseal)
    return is_whole


def _write_keys(keys: dict[str, KeyFile], folder: Path | None) -> None:
    if folder is not None:
        sealed_keys.write_keys(keys, folder)
        console.print(f"{len(keys):,} files of keys were written to {folder}")


def _known(folder: Path) -> dict[str, StoredObject]:
    """Return the inventory of the newest backup in the folder that has contents and is not damaged."""
    for name in backups_in(folder):
        match read_or_warn(folder, name):
            case manifest, inventory if manifest.copied:
                return {each.name: each for each in inventory}
    return {}


def _print_backup(backup: Backup) -> None:
    manifest = backup.manifest
    contents = "with their contents" if manifest.copied else "without their contents"
    console.print(f"backup {backup.folder.name} of {manifest.made}, capture2vr {manifest.version}")
    console.print(f"  database   {manifest.rows:,} rows, schema {manifest.schema}")
    console.print(f"  store      {manifest.objects:,} objects, {manifest.bytes:,} bytes, {contents}")
    if not manifest.sealed:
        warn(f"secrets of webhooks and sessions are in it as they are: set {sealed_keys.PASSPHRASE_VARIABLE}")
    console.print(f"  keys       {'encrypted' if backup.has_keys else 'none: name their folder with --keys'}")


def _restore_objects(store: Store, backup: Backup, inventory: list[StoredObject]) -> bool:
    if backup.manifest.copied:
        written = restore_objects(store, backup.contents, inventory)
        console.print(f"{written:,} of {len(inventory):,} objects were written to the store, the others were there")
        return True
    found = compare(store, inventory)
    console.print(f"the store has {len(inventory) - len(found.missing):,} of {len(inventory):,} objects of the backup")
    for what, names in (("missing", found.missing), ("changed", found.changed)):
        for each in names:
            console.print(f"{what}: {each}", markup=False)
    if found.newer:
        console.print(f"{len(found.newer):,} catalogues were written since the backup")
    return not found.missing and not found.changed


def _restore_database(settings: GatewaySettings, backup: Backup, unseal: Callable[[str], str] | None) -> None:
    with database_errors(settings, "cannot be filled"):
        done = import_database(settings.database, backup.folder / DATABASE, backup.manifest.schema, unseal)
    console.print(f"{done.rows:,} rows were written to the database; {done.queued:,} jobs that ran are queued again")
    record(settings, lambda records: records.add(backup.folder.name, backup.manifest.made_at))
    warn("what was deleted or revoked since the backup is back: look at `capture2vr keys list`")


def _check_database(settings: GatewaySettings, backup: Backup) -> None:
    file = sqlite_file(settings.database)
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
    with database_errors(settings, "is not restored to"):
        check_importable(settings.database, backup.manifest.schema)


def _check_store(store: Store, inventory: list[StoredObject]) -> None:
    if names := unexpected_objects(store, inventory):
        raise BadInput(
            f"the store is not empty: it has {listed(names)}, not as in the backup; name an empty bucket or folder, "
            "or restore --only database"
        )


def _keys_of(backup: Backup, folder: Path) -> dict[str, KeyFile]:
    """Decrypt a backup's keys. Raises BadInput where it has none, or the folder has others."""
    if not backup.has_keys:
        raise BadInput("this backup has no keys: it was made without --keys")
    keys = sealed_keys.unseal((backup.folder / KEYS).read_bytes(), sealed_keys.passphrase())
    sealed_keys.check_writable(keys, folder)
    return keys


def _export(url: str, out: Path, seal: Callable[[str], str] | None) -> Exported:
    file = sqlite_file(url)
    if file is not None and not file.exists():
        raise BadInput(f"{file}: there is no database; name the data folder with --data, or set GATEWAY_DATABASE_URL")
    try:
        return export_database(url, out, seal)
    except ValueError as error:
        raise BadInput(str(error)) from None
    except SQLAlchemyError as error:
        raise BadInput(f"the database cannot be read: {reason_of(error)}; see `capture2vr gateway check`") from error
