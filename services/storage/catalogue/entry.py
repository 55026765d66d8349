"""The catalogue: one small mutable document per asset key that says which immutable files are current."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from services.storage.bundle import Json
from services.storage.store import Head, Store

_KEY = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
_PREFIX, _SUFFIX = "catalog/", ".json"

DEFAULT_COLLECTION = "default"


@dataclass(frozen=True, slots=True)
class Entry:
    """The catalogue document of `key` as it was under `etag`."""

    key: str
    etag: str
    document: Mapping[str, Json]

    @property
    def version(self) -> int:
        return int(self.document["version"])

    @property
    def state(self) -> str:
        return str(self.document["state"])

    @property
    def manifest(self) -> str:
        """Object name of the current manifest."""
        return str(self.document["manifest"]["name"])

    @property
    def versions(self) -> list[dict[str, Any]]:
        return list(self.document["versions"])

    @property
    def removed(self) -> bool:
        """Whether the asset was taken out of sight; its files stay for a restoration."""
        return bool(self.document.get("removed"))

    @property
    def collections(self) -> list[str]:
        """Where the asset is listed; an entry older than collections belongs to the default one."""
        return list(self.document.get("collections", (DEFAULT_COLLECTION,)))


def valid_key(key: str) -> bool:
    """Whether a client may name an asset so: 1 to 100 letters, digits and ._- that begin with a letter or digit."""
    return _KEY.fullmatch(key) is not None


def check_key(key: str) -> str:
    """The key itself. Raises ValueError for one that `valid_key` refuses."""
    if not valid_key(key):
        raise ValueError(f"{key!r} is no asset key: use 1 to 100 of A-Z a-z 0-9 . _ - and begin with a letter or digit")
    return key


def check_collection(name: str) -> str:
    """The name itself. Raises ValueError for one that `valid_key` refuses: collections are named by the same rules."""
    if not valid_key(name):
        raise ValueError(
            f"{name!r} is no collection: use 1 to 100 of A-Z a-z 0-9 . _ - and begin with a letter or digit"
        )
    return name


def entry_name(key: str) -> str:
    """Object name of a key's catalogue document."""
    return f"{_PREFIX}{check_key(key)}{_SUFFIX}"


def alias_name(key: str) -> str:
    """Object name of a key's moving alias: `{"version", "manifest"}`, for clients that want nothing else."""
    return f"alias/{check_key(key)}/latest.json"


def entry(store: Store, key: str) -> Entry:
    """The catalogue entry of a key. Raises FileNotFoundError when nothing was published under it."""
    name = entry_name(key)
    # The tag is read before the content: if a writer comes between, the tag is the older one and a conditional put
    # under it is refused. The other order would let it overwrite what was never read.
    etag = store.head(name).etag
    return Entry(key, etag, json.loads(store.get(name)))


def list_keys(store: Store, *, after: str = "", limit: int = 100) -> list[str]:
    """Keys that have an asset, in the order of the store's names, behind the key `after`."""
    heads = store.list(_PREFIX, after=entry_name(after) if after else "", limit=limit)
    return [_key_of(head) for head in heads]


def _key_of(head: Head) -> str:
    return head.name.removeprefix(_PREFIX).removesuffix(_SUFFIX)
