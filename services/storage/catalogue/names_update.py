"""Change the names of an asset: a new catalogue entry and new rows, and no new version."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from capture2vr.storage.catalogue.change_entry import change_entry
from capture2vr.storage.catalogue.entry import Entry
from capture2vr.storage.catalogue.signing import NO_KEYS, Keys
from capture2vr.storage.store import Store


def change_names(store: Store, key: str, keys: Keys = NO_KEYS, **changes: Any) -> Entry:
    """Change some of an asset's names (fields of `AssetNames`), and return its new entry.

    Idempotent. Raises ValueError for a name that is too long or not one line, FileNotFoundError for an unknown key,
    OSError (CatalogueFault too) where the store fails; after that, change them again.
    """

    def differing(present: Entry, _: str) -> dict[str, Any]:
        names = replace(present.names, **changes).checked()
        return {} if names == present.names else names.as_json

    return change_entry(store, key, keys, differing)
