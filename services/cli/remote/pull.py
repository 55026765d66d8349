"""`capture2vr pull`: download an asset from a gateway, and print its files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.table import Table

from capture2vr.cli.progress import console, warn
from capture2vr.client.http import open_gateway
from capture2vr.client.pull import PulledAsset, pull
from capture2vr.client.share_link import split_link


def pull_asset(
    key: str,
    out: Path,
    gateway: str,
    *,
    collection: str = "",
    trusted: Sequence[Path] = (),
    cache: Path | None = None,
    share: str = "",
) -> dict[str, Any]:
    """Download the newest version of `key` into `out`, all of it or nothing, and return its manifest.

    share   a share link, which names the gateway; one of an asset also names the key, which may then be ""
    Other arguments and errors as of `pull`.
    """
    gateway, token = split_link(share) if share else (gateway, "")
    with open_gateway(gateway, follow_redirects=True) as client:
        pulled = pull(client, gateway, key, out, collection=collection, trusted=trusted, cache=cache, token=token)
    _print_result(pulled)
    return dict(pulled.manifest)


def _print_result(pulled: PulledAsset) -> None:
    table = Table(title=f"{pulled.key} version {pulled.version} ({pulled.state})")
    for column in ("file", "bytes", "sha256", "from"):
        table.add_column(column, justify="right" if column == "bytes" else "left", overflow="fold")
    for each in pulled.files:
        table.add_row(each.file, f"{each.bytes:,}", each.sha256, each.origin)
    console.print(table)
    if pulled.is_verified:
        console.print(f"{pulled.signed}: signature, version, sizes and hashes are correct")
    else:
        warn(
            f"{pulled.signed}: sizes and hashes are correct; signature and "
            "version were not checked: give a public key with --trusted or STORAGE_TRUSTED_KEYS"
        )
