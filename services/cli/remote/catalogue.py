"""`capture2vr catalogue verify | rebuild | keygen`: check collections, write them anew, make signing keys."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from capture2vr.cli.options import DEFAULT_GATEWAY, Collection, Gateway, Trusted
from capture2vr.storage.catalogue.entry import DEFAULT_COLLECTION

app = typer.Typer(help="Check, rebuild and sign the catalogues of collections.", no_args_is_help=True)


@app.command()
def verify(
    gateway: Gateway = DEFAULT_GATEWAY,
    collection: Collection = DEFAULT_COLLECTION,
    trusted: Trusted = None,
    at_least: Annotated[int, typer.Option(min=0, help="Fail if the collection's version is older than this.")] = 0,
    store: Annotated[
        bool, typer.Option("--store", help="Read from the store of the STORAGE_* variables, not from a gateway.")
    ] = False,
    every: Annotated[bool, typer.Option("--all", help="Check every collection of that store.")] = False,
) -> None:
    """Check a collection's signature, and the hash of every shard, manifest and file. Exit code 1 if one is wrong."""
    from capture2vr.cli.remote.catalogue_work import stored_collections, verify_collection

    source = "" if store or every else gateway
    names = stored_collections() if every else [collection]
    results = [verify_collection(name, source, trusted or (), at_least=at_least) for name in names]
    if not all(results):
        raise typer.Exit(1)


@app.command()
def rebuild(
    collection: Collection = DEFAULT_COLLECTION,
    every: Annotated[bool, typer.Option("--all", help="Rebuild every collection on the store.")] = False,
) -> None:
    """Write a collection anew from the assets on the store of the STORAGE_* variables, and sign it with their keys.

    Use it for a store made before collections existed, after changing the keys, or after damage. The assets on the
    store are trusted without a check.
    """
    from capture2vr.cli.remote.catalogue_work import rebuild_collection, stored_collections

    for name in stored_collections() if every else [collection]:
        rebuild_collection(name)


@app.command()
def keygen(out: Annotated[Path, typer.Argument(help="File of the private key; the public key gets OUT.pub.")]) -> None:
    """Generate a key pair (Ed25519) to sign collections; the private key gets mode 0600. Never overwrites a file."""
    from capture2vr.cli.remote.catalogue_work import make_key

    make_key(out)
