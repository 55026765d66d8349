"""`capture2vr ls | rm | restore`: what a collection has, and taking assets out of sight and back."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import httpx
from rich.table import Table
from rich.text import Text

from services.cli.errors import NO_KEY, BadInput, answer_of, plain
from services.cli.http import client_of
from services.cli.progress import console
from services.storage.catalogue import valid_key

_PAGE = 100  # assets; the most that a gateway gives at once


def list_assets(gateway: str, *, collection: str, label: str) -> int:
    """Print the assets of a collection whose label matches; how many there are. Raises BadInput."""
    check_collection(collection)
    try:
        with client_of(gateway) as client:
            rows = list(_rows(client, collection, label))
    except (httpx.TransportError, httpx.InvalidURL) as error:
        raise BadInput(f"{gateway} cannot be reached: {error}") from error
    table = Table(title=f"{collection}: {len(rows):,} assets")
    for column in ("key", "label", "labels", "version", "state", "updated"):
        table.add_column(column, justify="right" if column == "version" else "left", overflow="fold")
    for row in rows:
        names = (row["key"], row["label"], ", ".join(row["labels"]))
        facts = (str(row["version"]), row["state"], row["updated"])
        table.add_row(*(Text(plain(cell)) for cell in (*names, *facts)))  # a label may look like markup
    console.print(table)
    return len(rows)


def mark(key: str, gateway: str, verb: str, *, collection: str) -> None:
    """`remove` or `restore` an asset at the gateway, with a collection only if it is in that one. Raises BadInput."""
    if not valid_key(key):
        raise BadInput(NO_KEY.format(key))
    if collection:
        check_collection(collection)
    try:
        with client_of(gateway) as client:
            told = answer_of(client.post(f"/v1/assets/{key}/{verb}", params={"collection": collection}))
    except (httpx.TransportError, httpx.InvalidURL) as error:
        raise BadInput(f"{gateway} cannot be reached: {error}") from error
    state = "removed; its files stay, and `restore` brings it back" if told["removed"] else "there"
    console.print(f"{key} version {told['version']} is {state}")


def check_collection(name: str) -> None:
    """Raises BadInput for what cannot be a collection."""
    if not valid_key(name):
        raise BadInput(NO_KEY.format(name).replace("asset key", "collection"))


def _rows(client: httpx.Client, collection: str, label: str) -> Iterator[dict[str, Any]]:
    after: str | None = ""
    while after is not None:
        asked: dict[str, str | int] = {"label": label, "after": after, "limit": _PAGE}
        page = answer_of(client.get(f"/v1/collections/{collection}/assets", params=asked))
        yield from page["assets"]
        after = page["next"]
