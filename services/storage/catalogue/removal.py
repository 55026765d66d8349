"""Remove (hide) an asset and restore it: sets a mark in its entry and its collections, and deletes no file."""

from __future__ import annotations

from capture2vr.storage.catalogue.change_entry import change_entry
from capture2vr.storage.catalogue.entry import Entry
from capture2vr.storage.catalogue.signing import NO_KEYS, Keys
from capture2vr.storage.store import Store


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
    def changes(present: Entry, now: str) -> dict[str, str | None]:
        return {} if present.removed == removed else {"removed": now if removed else None}

    return change_entry(store, key, keys, changes)
