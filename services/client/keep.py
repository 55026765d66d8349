"""Keep a version of an asset that was held back because its grade says to shoot again."""

from __future__ import annotations

from typing import Any
from urllib.parse import quote

import httpx

from capture2vr.client.answers import parse_answer, understood
from capture2vr.client.names import check_key
from capture2vr.errors import BadInput


def keep_version(client: httpx.Client, key: str, version: int | None = None) -> int:
    """Publish a version that was held back, and return its new number.

    version  its number; None: the newest of those that were held back
    Raises BadInput where none is, GatewayError.
    """
    check_key(key)
    path = f"/v1/assets/{quote(key, safe='')}"
    with understood("list of versions"):
        number = version or _newest_held(key, parse_answer(client.get(path)))
        return int(parse_answer(client.post(f"{path}/versions/{number}/restore"))["version"])


def _newest_held(key: str, entry: dict[str, Any]) -> int:
    """Return the number of the newest version that is held back and came after the current one, or is it."""
    held = [each["version"] for each in entry.get("versions") or [] if each.get("held")]
    newest = max(held, default=0)
    if newest < entry["version"]:
        raise BadInput(f"{key}: no newer version than {entry['version']}, which is served, is held back")
    return int(newest)
