"""`capture2vr name`: change an asset's label, description and tags."""

from __future__ import annotations

from collections.abc import Sequence

import httpx
from rich.text import Text

from capture2vr.cli.errors import BadInput, parse_answer, printable
from capture2vr.cli.key_names import check_key
from capture2vr.cli.progress import console
from capture2vr.cli.remote.http import client_of


def change_names(
    key: str, gateway: str, *, label: str | None, description: str | None, labels: Sequence[str] | None
) -> None:
    """Change the names that are not None at the gateway, and print what the asset is called then. Raises BadInput."""
    check_key(key)
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
