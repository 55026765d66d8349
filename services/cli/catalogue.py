"""`capture2vr catalogue verify | rebuild | keygen`: whether a collection is whole, and whose it is."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from services.cli.options import DEFAULT_GATEWAY, Collection, Gateway, Trusted
from services.storage.catalogue import DEFAULT_COLLECTION

app = typer.Typer(help="Signed catalogues of collections: verify, rebuild, keygen.", no_args_is_help=True)


@app.command()
def verify(
    gateway: Gateway = DEFAULT_GATEWAY,
    collection: Collection = DEFAULT_COLLECTION,
    trusted: Trusted = None,
    at_least: Annotated[int, typer.Option(min=0, help="Refuse an older version than this.")] = 0,
    store: Annotated[bool, typer.Option("--store", help="Read the store of the STORAGE_* variables instead.")] = False,
    every: Annotated[bool, typer.Option("--all", help="Every collection of that store.")] = False,
) -> None:
    """Follow every hash: index, shards, manifests, files. Exit code 1 at the first class that has a fault."""
    from services.cli.collections import on_the_store, verify_collection

    place = "" if store or every else gateway
    names = on_the_store() if every else [collection]
    whole = [verify_collection(name, place, trusted or (), at_least=at_least) for name in names]
    if not all(whole):
        raise typer.Exit(1)


@app.command()
def rebuild(
    collection: Collection = DEFAULT_COLLECTION,
    every: Annotated[bool, typer.Option("--all", help="Every collection that is on the store.")] = False,
) -> None:
    """Write a collection anew from the entries on the store of the STORAGE_* variables, and sign it with their keys.

    For a store that is older than collections, for new keys, and after damage. What stands on the store is believed.
    """
    from services.cli.collections import on_the_store, rebuild_collection

    for name in on_the_store() if every else [collection]:
        rebuild_collection(name)


@app.command()
def keygen(out: Annotated[Path, typer.Argument(help="File for the private key; OUT.pub is for readers.")]) -> None:
    """Make a key to sign with (mode 0600) and its public half. Nothing is overwritten."""
    from services.cli.collections import make_key

    make_key(out)
