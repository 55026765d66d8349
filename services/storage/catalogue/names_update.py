"""Change the names of an asset: a new catalogue entry and new rows, and no new version."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from services.storage.catalogue.compare_and_swap import canonical_json, now_iso, put_mutable, retry_on_conflict
from services.storage.catalogue.entry import Entry, check_key, entry_name, read_entry
from services.storage.catalogue.signing import NO_KEYS, Keys
from services.storage.catalogue.unity_update import update_unity_catalogues
from services.storage.catalogue.update import update_collections
from services.storage.store import Store


def change_names(store: Store, key: str, keys: Keys = NO_KEYS, **changes: Any) -> Entry:
    """Change some of an asset's names (fields of `AssetNames`), and return its new entry.

    Idempotent. Raises ValueError for a name that is too long or not one line, FileNotFoundError for an unknown key,
    OSError (CatalogueFault too) where the store fails; after that, change them again.
    """

    def attempt() -> None:
        present = read_entry(store, key)
        names = replace(present.names, **changes).checked()
        if names != present.names:
            document = {**present.document, **names.as_json, "updated": now_iso()}
            put_mutable(store, entry_name(key), canonical_json(document), present.etag)

    check_key(key)
    retry_on_conflict(attempt)
    update_collections(store, key, keys)
    update_unity_catalogues(store, key)
    return read_entry(store, key)
