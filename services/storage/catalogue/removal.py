"""Remove (hide) an asset and restore it: sets a mark in its entry and its collections, and deletes no file."""

from __future__ import annotations

from services.storage.catalogue.compare_and_swap import canonical_json, now_iso, put_mutable, retry_on_conflict
from services.storage.catalogue.entry import Entry, check_key, entry_name, read_entry
from services.storage.catalogue.signing import NO_KEYS, Keys
from services.storage.catalogue.unity_update import update_unity_catalogues
from services.storage.catalogue.update import update_collections
from services.storage.store import Store


def remove(store: Store, key: str, keys: Keys = NO_KEYS) -> Entry:
    """Hide an asset until it is restored or a new version is published, and return its new entry.

    Idempotent. Raises FileNotFoundError for an unknown key, OSError (CatalogueFault too) where the store fails; after
    that, remove again.
    """
    return _set_removed(store, key, keys, removed=True)


def restore(store: Store, key: str, keys: Keys = NO_KEYS) -> Entry:
    """Show a removed asset again and return its new entry. Idempotent; raises as `remove` does."""
    return _set_removed(store, key, keys, removed=False)


def _set_removed(store: Store, key: str, keys: Keys, *, removed: bool) -> Entry:
    def attempt() -> None:
        present = read_entry(store, key)
        if present.removed != removed:
            now = now_iso()
            document = {**present.document, "updated": now, "removed": now if removed else None}
            put_mutable(store, entry_name(key), canonical_json(document), present.etag)

    check_key(key)
    retry_on_conflict(attempt)
    update_collections(store, key, keys)
    update_unity_catalogues(store, key)
    return read_entry(store, key)
