"""`capture2vr ls | rm | restore`: list the assets of a collection, remove (hide) one, restore it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import httpx
from rich.table import Table
from rich.text import Text

from services.cli.errors import INVALID_KEY, BadInput, parse_answer, printable
from services.cli.http import client_of
from services.cli.progress import console
from services.storage.catalogue.entry import valid_key

_PAGE = 100  # assets per request: the gateway's maximum


def list_assets(gateway: str, *, collection: str, label: str) -> int:
    """Print the assets of a collection whose label matches, and return their number. Raises BadInput."""
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
        table.add_row(
            *(Text(printable(cell)) for cell in (*names, *facts))
        )  # Text, because labels may look like markup
    console.print(table)
    return len(rows)


def set_removed(key: str, gateway: str, verb: str, *, collection: str) -> None:
    """Remove or restore an asset at the gateway. Raises BadInput.

    verb        remove | restore
    collection  do it only if the asset is in this collection; "": in any case
    """
    if not valid_key(key):
        raise BadInput(INVALID_KEY.format(key))
    if collection:
        check_collection(collection)
    try:
        with client_of(gateway) as client:
            answer = parse_answer(client.post(f"/v1/assets/{key}/{verb}", params={"collection": collection}))
    except (httpx.TransportError, httpx.InvalidURL) as error:
        raise BadInput(f"{gateway} cannot be reached: {error}") from error
    state = "removed; its files are kept, and `restore` brings it back" if answer["removed"] else "available"
    console.print(f"{key} version {answer['version']} is {state}")


def check_collection(name: str) -> None:
    """Raises BadInput for an invalid collection name."""
    if not valid_key(name):
        raise BadInput(INVALID_KEY.format(name).replace("asset key", "collection"))


def _rows(client: httpx.Client, collection: str, label: str) -> Iterator[dict[str, Any]]:
    after: str | None = ""
    while after is not None:
        query: dict[str, str | int] = {"label": label, "after": after, "limit": _PAGE}
        page = parse_answer(client.get(f"/v1/collections/{collection}/assets", params=query))
        yield from page["assets"]
        after = page["next"]
