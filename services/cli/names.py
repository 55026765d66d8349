"""`capture2vr name`: change an asset's label, description and search words."""

from __future__ import annotations

from collections.abc import Sequence

import httpx
from rich.text import Text

from services.cli.errors import INVALID_KEY, BadInput, parse_answer, printable
from services.cli.http import client_of
from services.cli.progress import console
from services.storage.catalogue.entry import valid_key


def change_names(
    key: str, gateway: str, *, label: str | None, description: str | None, labels: Sequence[str] | None
) -> None:
    """Change the names that are not None at the gateway, and print what the asset is called then. Raises BadInput."""
    if not valid_key(key):
        raise BadInput(INVALID_KEY.format(key))
    given = {"label": label, "description": description, "labels": labels}
    changes = {name: value for name, value in given.items() if value is not None}
    if not changes:
        raise BadInput("nothing to change: give --label, --description, --tag or --no-tags")
    try:
        with client_of(gateway) as client:
            answer = parse_answer(client.patch(f"/v1/assets/{key}", json=changes))
    except (httpx.TransportError, httpx.InvalidURL) as error:
        raise BadInput(f"{gateway} cannot be reached: {error}") from error
    words = f" ({', '.join(answer['labels'])})" if answer["labels"] else ""
    console.print(Text(printable(f"{key}: {answer['label']}{words}")), soft_wrap=True)
    if answer["description"]:
        console.print(Text(printable(answer["description"])), soft_wrap=True)
