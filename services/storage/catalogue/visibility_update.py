"""Set the visibility of an asset or a collection, and update the lists that this changes."""

from __future__ import annotations

from capture2vr.storage.catalogue.change_entry import change_entry
from capture2vr.storage.catalogue.collection import Index
from capture2vr.storage.catalogue.entry import Entry
from capture2vr.storage.catalogue.signing import NO_KEYS, Keys
from capture2vr.storage.catalogue.unity_update import rebuild_unity_catalogues
from capture2vr.storage.catalogue.update import change_visibility
from capture2vr.storage.catalogue.visibility import Visibility
from capture2vr.storage.store import Store


def set_asset_visibility(store: Store, key: str, visibility: Visibility | None, keys: Keys = NO_KEYS) -> Entry:
    """Set an asset's own visibility, or let it have that of its collections (None); return its new entry.

    Idempotent. Raises FileNotFoundError for an unknown key, OSError (CatalogueFault too) where the store fails; after
    that, set it again.
    """

    def changes(present: Entry, _: str) -> dict[str, Visibility | None]:
        return {} if present.visibility == visibility else {"visibility": visibility}

    return change_entry(store, key, keys, changes)


def set_collection_visibility(store: Store, name: str, visibility: Visibility | None, keys: Keys = NO_KEYS) -> Index:
    """Set a collection's visibility and return its new index. Its list then leaves out, or has again, what is not
    public.

    Idempotent. Raises FileNotFoundError for an unknown collection, OSError (CatalogueFault too) as
    `update_collections`.
    """
    index = change_visibility(store, name, visibility, keys)
    rebuild_unity_catalogues(store, name)
    return index
