"""Set the visibility of an asset or a collection, and update the lists that this changes."""

from __future__ import annotations

from services.storage.catalogue.collection import Index
from services.storage.catalogue.compare_and_swap import canonical_json, now_iso, put_mutable, retry_on_conflict
from services.storage.catalogue.entry import Entry, check_key, entry_name, read_entry
from services.storage.catalogue.signing import NO_KEYS, Keys
from services.storage.catalogue.unity_update import rebuild_unity_catalogues, update_unity_catalogues
from services.storage.catalogue.update import change_visibility, update_collections
from services.storage.catalogue.visibility import Visibility
from services.storage.store import Store


def set_asset_visibility(store: Store, key: str, visibility: Visibility | None, keys: Keys = NO_KEYS) -> Entry:
    """Set an asset's own visibility, or let it have that of its collections (None); return its new entry.

    Idempotent. Raises FileNotFoundError for an unknown key, OSError (CatalogueFault too) where the store fails; after
    that, set it again.
    """

    def attempt() -> None:
        present = read_entry(store, key)
        if present.visibility != visibility:
            document = {**present.document, "visibility": visibility, "updated": now_iso()}
            put_mutable(store, entry_name(key), canonical_json(document), present.etag)

    check_key(key)
    retry_on_conflict(attempt)
    update_collections(store, key, keys)
    update_unity_catalogues(store, key)
    return read_entry(store, key)


def set_collection_visibility(store: Store, name: str, visibility: Visibility | None, keys: Keys = NO_KEYS) -> Index:
    """Set a collection's visibility and return its new index. Its list then leaves out, or has again, what is not
    public.

    Idempotent. Raises FileNotFoundError for an unknown collection, OSError (CatalogueFault too) as
    `update_collections`.
    """
    index = change_visibility(store, name, visibility, keys)
    rebuild_unity_catalogues(store, name)
    return index
