"""Change facts in an asset's catalogue entry, and the lists that show them: no new version, no file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from capture2vr.storage.catalogue.compare_and_swap import canonical_json, now_iso, put_mutable, retry_on_conflict
from capture2vr.storage.catalogue.entry import Entry, check_key, entry_name, read_entry
from capture2vr.storage.catalogue.signing import NO_KEYS, Keys
from capture2vr.storage.catalogue.update import update_collections
from capture2vr.storage.catalogue.visibility import Visibility
from capture2vr.storage.store import Store


def change_entry(store: Store, key: str, keys: Keys, changes: Callable[[Entry, str], Mapping[str, Any]]) -> Entry:
    """Change an asset's entry by compare-and-swap, update its collections, and return the new entry.

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
    return read_entry(store, key)


def change_names(store: Store, key: str, keys: Keys = NO_KEYS, **changes: Any) -> Entry:
    """Change some of an asset's names (fields of `AssetNames`), and return its new entry.

    Idempotent. Raises ValueError for a name that is too long or not one line, FileNotFoundError for an unknown key,
    OSError (CatalogueFault too) where the store fails; after that, change them again.
    """

    def differing(present: Entry, _: str) -> dict[str, Any]:
        names = replace(present.names, **changes).checked()
        return {} if names == present.names else names.as_json

    return change_entry(store, key, keys, differing)


def remove(store: Store, key: str, keys: Keys = NO_KEYS) -> Entry:
    """Hide an asset, all its files kept, until it is restored or a new version is published, and return its new entry.

    Idempotent. Raises FileNotFoundError for an unknown key, OSError (CatalogueFault too) where the store fails; after
    that, remove again.
    """
    return _set_removed(store, key, keys, removed=True)


def restore(store: Store, key: str, keys: Keys = NO_KEYS) -> Entry:
    """Show a removed asset again and return its new entry. Idempotent; raises as `remove` does."""
    return _set_removed(store, key, keys, removed=False)


def set_asset_visibility(store: Store, key: str, visibility: Visibility | None, keys: Keys = NO_KEYS) -> Entry:
    """Set an asset's own visibility, or let it have that of its collections (None); return its new entry.

    Idempotent. Raises FileNotFoundError for an unknown key, OSError (CatalogueFault too) where the store fails; after
    that, set it again.
    """

    def changes(present: Entry, _: str) -> dict[str, Visibility | None]:
        return {} if present.visibility == visibility else {"visibility": visibility}

    return change_entry(store, key, keys, changes)


def _set_removed(store: Store, key: str, keys: Keys, *, removed: bool) -> Entry:
    def changes(present: Entry, now: str) -> dict[str, str | None]:
        return {} if present.removed == removed else {"removed": now if removed else None}

    return change_entry(store, key, keys, changes)
