"""`capture2vr catalogue verify | rebuild | keygen`: whether a collection is whole, and whose it is."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from services.storage.catalogue import DEFAULT_COLLECTION

app = typer.Typer(help="Signed catalogues of collections: verify, rebuild, keygen.", no_args_is_help=True)

Gateway = Annotated[str, typer.Option("--gateway", help="URL of the gateway.", envvar="CAPTURE2VR_GATEWAY")]
Collection = Annotated[str, typer.Option(help="Which collection.")]
Trusted = Annotated[
    list[Path] | None, typer.Option(help="Public key (PEM) to believe; may be repeated. Else STORAGE_TRUSTED_KEYS.")
]


@app.command()
def verify(
    gateway: Gateway = "http://127.0.0.1:8080",
    collection: Collection = DEFAULT_COLLECTION,
    trusted: Trusted = None,
    at_least: Annotated[int, typer.Option(min=0, help="Refuse an older version than this.")] = 0,
    store: Annotated[bool, typer.Option("--store", help="Read the store of the STORAGE_* variables instead.")] = False,
) -> None:
    """Follow every hash: index, shards, manifests, files. Exit code 1 at the first class that has a fault."""
    from services.cli.collections import verify_collection

    if not verify_collection(collection, "" if store else gateway, trusted or (), at_least=at_least):
        raise typer.Exit(1)


@app.command()
def rebuild(collection: Collection = DEFAULT_COLLECTION) -> None:
    """Write a collection anew from the entries on the store of the STORAGE_* variables, and sign it with their keys.

    For a store that is older than collections, for new keys, and after damage. What stands on the store is believed.
    """
    from services.cli.collections import rebuild_collection

    rebuild_collection(collection)


@app.command()
def keygen(out: Annotated[Path, typer.Argument(help="File for the private key; OUT.pub is for readers.")]) -> None:
    """Make a key to sign with (mode 0600) and its public half. Nothing is overwritten."""
    from services.cli.collections import make_key

    make_key(out)
