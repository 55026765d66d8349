"""`capture2vr gateway`: run one; `gateway migrate | check | restore | scrub`: look after its database and store."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from capture2vr.cli.options import Open

app = typer.Typer(invoke_without_command=True)

Data = Annotated[
    Path, typer.Option("--data", help="Data folder of `capture2vr up`; GATEWAY_* variables name another database.")
]
_DATA = Path("capture2vr-data")


@app.callback()
def gateway(context: typer.Context, everybody: Open = False) -> None:
    """Run a gateway alone, configured by the environment variables GATEWAY_* and STORAGE_*."""
    if context.invoked_subcommand is None:
        from capture2vr.gateway.__main__ import start

        raise typer.Exit(start(everybody=everybody))


@app.command()
def migrate(
    data: Data = _DATA,
    wait: Annotated[float, typer.Option(min=0, help="Seconds to wait for a database that does not answer.")] = 60.0,
) -> None:
    """Bring the jobs' database up to date, before the gateways of a new version start; those of the last may go on.

    Exit code 2 where it cannot be done, such as for a database of a newer version.
    """
    from capture2vr.cli.backups.database_work import migrate_database

    migrate_database(data, wait)


@app.command()
def check(data: Data = _DATA) -> None:
    """Check the jobs' database and its snapshots. Exit code 1 if the database is damaged."""
    from capture2vr.cli.backups.database_work import check_database

    if not check_database(data):
        raise typer.Exit(1)


@app.command()
def restore(data: Data = _DATA) -> None:
    """Restore a damaged database from the newest snapshot, from what can be read of it, and from the store.

    Stop the gateway first. The damaged file is kept.
    """
    from capture2vr.cli.backups.database_work import restore_database

    restore_database(data)


@app.command()
def scrub(data: Data = _DATA) -> None:
    """Read every file of every asset on the store and check its hash. Exit code 1 if one is damaged."""
    from capture2vr.cli.backups.database_work import scrub_store

    if not scrub_store(data):
        raise typer.Exit(1)
