"""List the assets of a gateway's collection."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import httpx

from capture2vr.client.answers import paged

_PAGE = 100  # assets per request: the gateway's maximum


@dataclass(frozen=True, slots=True)
class ListedAsset:
    """An asset in a list.

    key      for `Client.pull`
    label    a name for people; labels: search words
    state    "preview", "refined" or "removed"
    updated  time of the last change, ISO 8601
    bytes    size of all files; None where it is not known
    grade    "good", "usable", "incomplete" or "shoot again"; "" where nothing could tell
    view     path of its page at the gateway
    """

    key: str
    label: str
    labels: tuple[str, ...]
    version: int
    state: str
    updated: str
    bytes: int | None
    view: str
    grade: str = ""

    @classmethod
    def of(cls, row: Mapping[str, Any]) -> ListedAsset:
        """Convert a row of the API."""
        return cls(
            key=str(row["key"]),
            label=str(row["label"]),
            labels=tuple(row["labels"]),
            version=int(row["version"]),
            state=str(row["state"]),
            updated=str(row["updated"]),
            bytes=row["bytes"],
            view=str(row["view"]),
            grade=str(row.get("grade", "")),
        )


def assets_of(client: httpx.Client, collection: str, query: Mapping[str, str | int]) -> Iterator[ListedAsset]:
    """Yield the assets of a collection, sorted by key. query: of the API's search. Raises GatewayError."""
    path = f"/v1/collections/{collection}/assets"
    return paged(client, path, "assets", {**query, "limit": _PAGE}, ListedAsset.of)
