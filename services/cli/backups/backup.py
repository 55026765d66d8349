"""`capture2vr backup`: the database, the store's objects and the keys, saved to one folder, and restored from it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

app = typer.Typer(help="Back up the database, the store and the keys, and restore them.", no_args_is_help=True)

Folder = Annotated[Path, typer.Argument(help="Folder of the backups; each new one only adds what is new.")]
At = Annotated[str, typer.Option("--at", help="Name of the backup, as `create` printed it. Default: the newest.")]
Data = Annotated[
    Path,
    typer.Option(
        "--data", help="Data folder of `capture2vr up`; GATEWAY_* and STORAGE_* variables name another database, store."
    ),
]
Keep = Annotated[
    int, typer.Option("--keep", min=0, help="Remove old backups, but not the newest so many; 0: none by their number.")
]
KeepDays = Annotated[
    float, typer.Option("--keep-days", min=0, help="Remove backups that are older than so many days; 0: none by age.")
]
_DATA = Path("capture2vr-data")


@app.command()
def create(
    folder: Folder,
    with_objects: Annotated[
        bool, typer.Option("--with-objects", help="Copy the objects too, not only their names, sizes and etags.")
    ] = False,
    keys: Annotated[
        Path | None,
        typer.Option(help="Folder of keys to add, encrypted by the passphrase in CAPTURE2VR_BACKUP_PASSPHRASE."),
    ] = None,
    keep: Keep = 0,
    keep_days: KeepDays = 0.0,
    data: Data = _DATA,
) -> None:
    """Write a backup. Gateways and workers may go on meanwhile.

    With a passphrase in CAPTURE2VR_BACKUP_PASSPHRASE the secrets in the database's rows are encrypted.
    """
    from capture2vr.cli.backups.backup_folder import BackupRetention
    from capture2vr.cli.backups.backup_work import create_backup

    create_backup(folder, data, with_objects=with_objects, keys=keys, keep=BackupRetention(keep, keep_days))


@app.command()
def verify(folder: Folder, at: At = "") -> None:
    """Check the hash of every file of a backup. Exit code 1 if one is damaged or missing."""
    from capture2vr.cli.backups.backup_work import verify_backup

    if not verify_backup(folder, at):
        raise typer.Exit(1)


@app.command()
def drill(folder: Folder, at: At = "", data: Data = _DATA) -> None:
    """Prove that a backup can be restored: restore it beside the service, compare, and remove it again.

    Gateways and workers may go on meanwhile. Exit code 1 if something is not as in the backup.
    """
    from capture2vr.cli.backups.drill import drill_backup

    if not drill_backup(folder, at, data):
        raise typer.Exit(1)


@app.command()
def prune(folder: Folder, keep: Keep = 0, keep_days: KeepDays = 0.0) -> None:
    """Remove old backups, and the contents that only they have."""
    from capture2vr.cli.backups.backup_folder import BackupRetention
    from capture2vr.cli.backups.backup_work import prune_backups
    from capture2vr.errors import BadInput

    if not keep and not keep_days:
        raise BadInput("say which backups stay: --keep 14, --keep-days 90, or both")
    prune_backups(folder, BackupRetention(keep, keep_days))


@app.command()
def restore(
    folder: Folder,
    at: At = "",
    only: Annotated[
        Literal["database", "objects", "keys"] | None, typer.Option(help="Restore only this part. Default: all.")
    ] = None,
    keys: Annotated[
        Path | None,
        typer.Option(help="Folder to write the keys to; the passphrase is in CAPTURE2VR_BACKUP_PASSPHRASE."),
    ] = None,
    data: Data = _DATA,
) -> None:
    """Restore a backup into an empty database, store and folder of keys. Stop the gateways first.

    A backup without the objects' contents is compared with the store. Exit code 1 if that lacks an object.
    """
    from capture2vr.cli.backups.backup_work import Parts, restore_backup
    from capture2vr.errors import BadInput

    if only == "keys" and keys is None:
        raise BadInput("--only keys needs --keys: an empty folder to write them to")
    parts = Parts(only in (None, "database"), only in (None, "objects"), keys if only in (None, "keys") else None)
    if not restore_backup(folder, at, data, parts):
        raise typer.Exit(1)
