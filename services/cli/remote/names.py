"""`capture2vr name`: change an asset's label, description and tags."""

from __future__ import annotations

from collections.abc import Sequence

from rich.text import Text

from capture2vr.cli.printable import printable
from capture2vr.cli.progress import console
from capture2vr.client.answers import parse_answer
from capture2vr.client.http import open_gateway
from capture2vr.client.names import check_key
from capture2vr.errors import BadInput


def change_names(
    key: str, gateway: str, *, label: str | None, description: str | None, labels: Sequence[str] | None
) -> None:
    """Change the names that are not None at the gateway, and print what the asset is called then. Raises BadInput."""
    check_key(key)
    given = {"label": label, "description": description, "labels": labels}
    changes = {name: value for name, value in given.items() if value is not None}
    if not changes:
        raise BadInput("nothing to change: give --label, --description, --tag or --no-tags")
    with open_gateway(gateway) as client:
        answer = parse_answer(client.patch(f"/v1/assets/{key}", json=changes))
        words = f" ({', '.join(answer['labels'])})" if answer["labels"] else ""
        console.print(Text(printable(f"{key}: {answer['label']}{words}")), soft_wrap=True)
        if answer["description"]:
            console.print(Text(printable(str(answer["description"]))), soft_wrap=True)
