"""Change facts in an asset's catalogue entry, and the lists that show them: no new version, no file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from capture2vr.storage.catalogue.compare_and_swap import canonical_json, now_iso, put_mutable, retry_on_conflict
from capture2vr.storage.catalogue.entry import Entry, check_key, entry_name, read_entry
from capture2vr.storage.catalogue.signing import Keys
from capture2vr.storage.catalogue.unity_update import update_unity_catalogues
from capture2vr.storage.catalogue.update import update_collections
from capture2vr.storage.store import Store


def change_entry(store: Store, key: str, keys: Keys, changes: Callable[[Entry, str], Mapping[str, Any]]) -> Entry:
    """Change an asset's entry by compare-and-swap, update its collections and Unity's catalogues, return the new entry.

    changes  (entry, time now as ISO 8601) -> the fields that differ; nothing: the entry is not written

    Raises FileNotFoundError for an unknown key, OSError (CatalogueFault too) where the store fails; after that, change
    it again.
    """

    def attempt() -> None:
        present, now = read_entry(store, key), now_iso()
        if differing := changes(present, now):
            document = {**present.document, "updated": now, **differing}
            put_mutable(store, entry_name(key), canonical_json(document), present.etag)

    check_key(key)
    retry_on_conflict(attempt)
    update_collections(store, key, keys)
    update_unity_catalogues(store, key)
    return read_entry(store, key)
