"""Implementation of `capture2vr shares`: share links of a gateway, by its API."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from typing import Any

import httpx
import typer
from rich.table import Table
from rich.text import Text

from capture2vr.cli.printable import printable
from capture2vr.cli.progress import console, print_listing
from capture2vr.client.answers import paged, parse_answer
from capture2vr.client.names import check_collection, check_key
from capture2vr.client.share_link import PASSWORD_VARIABLE
from capture2vr.errors import BadInput
from capture2vr.gateway.access.shares import SHARE_ID

_PAGE = 200


@dataclass(frozen=True, slots=True)
class ShareOptions:
    """A share link to be created. mode: read or place; expires_days 0: it works until it is revoked"""

    name: str
    is_collection: bool
    mode: str
    label: str
    expires_days: int


def create_share(client: httpx.Client, options: ShareOptions) -> None:
    """Create a share link and print it to standard output. Raises BadInput."""
    if options.is_collection:
        check_collection(options.name)
    else:
        check_key(options.name)
    body = {
        "collection" if options.is_collection else "asset": options.name,
        "mode": options.mode,
        "label": options.label,
        "expires_days": options.expires_days or None,
        "password": os.environ.get(PASSWORD_VARIABLE, ""),
    }
    share = parse_answer(client.post("/v1/shares", json=body))
    until = f"until {share['expires']}" if share["expires"] else "until it is revoked"
    with_password = ", with a password" if share["has_password"] else ""
    console.print(f"{share['id']} opens {share['name']} {until}{with_password}: whoever has the link needs no login")
    typer.echo(share["url"])


def list_shares(client: httpx.Client) -> None:
    """Print a table of share links, the oldest first. Raises BadInput."""
    table = Table()
    for column in ("id", "opens", "may", "label", "state", "opened", "link"):
        table.add_column(column, overflow="fold", no_wrap=column == "id")
    for share in paged(client, "/v1/shares", "shares", {"limit": _PAGE}, dict):
        thing = f"{share['kind']} {share['name']}"
        texts = (share["id"], thing, share["mode"], share["label"], _state(share), share["opened"], share["url"])
        table.add_row(*(Text(printable(str(text))) for text in texts))
    print_listing(table)


def revoke_share(client: httpx.Client, share: str) -> None:
    """Revoke a share link. Raises BadInput where there is none."""
    if not re.fullmatch(SHARE_ID, share):
        raise BadInput(f"'{printable(share)}' is not the id of a share: `shares list` tells it")
    revoked = parse_answer(client.delete(f"/v1/shares/{share}"))
    console.print(f"{revoked['id']} of {revoked['name']} is revoked: its link is refused within a minute")


def _state(share: dict[str, Any]) -> str:
    if share["ended"]:
        return str(share["ended"])
    return f"until {share['expires']}" if share["expires"] else "until revoked"
