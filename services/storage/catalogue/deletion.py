"""Delete assets for good: their files, versions, catalogue entries and rows. What is deleted cannot be restored."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from capture2vr.storage.catalogue.change_entry import remove
from capture2vr.storage.catalogue.entry import alias_name, check_key, entry_name
from capture2vr.storage.catalogue.root import index_name, root_name
from capture2vr.storage.catalogue.signing import NO_KEYS, Keys
from capture2vr.storage.catalogue.update import empty, remove_row
from capture2vr.storage.store import Head, Store, list_all
from capture2vr.storage.tenant_store import FOLDER

_COLLECTIONS = "collections/"
_ROOTS = ("/root.json", "/index.json")


@dataclass(frozen=True, slots=True)
class DeletedObject:
    """An object that was deleted: its name in the tenant's store, its size in bytes, and the URL that caches know."""

    name: str
    size: int
    url: str


def delete_asset(store: Store, key: str, keys: Keys = NO_KEYS) -> list[DeletedObject]:
    """Delete an asset with all its versions for good, and return the objects that went.

    It is hidden first and its entry goes last: after a failure in between nobody sees half of it, and deleting again
    completes the work. Nothing may publish under this key meanwhile. Raises FileNotFoundError for an unknown key,
    ValueError for an invalid one, OSError (CatalogueFault too) where the store fails.
    """
    entry = remove(store, check_key(key), keys)
    for collection in entry.collections:
        remove_row(store, collection, key, keys)
    deleted = delete_objects(store, list_all(store, f"assets/{key}/"))
    return deleted + delete_objects(store, _heads(store, alias_name(key), entry_name(key)))


def delete_everything(store: Store, keys: Keys = NO_KEYS) -> tuple[list[DeletedObject], list[str]]:
    """Delete all objects of a tenant's store; return those that went, and the names of those that stay.

    What stays are the roots of its collections without a row: a client that has seen one would go on with its copy if
    there were none. Idempotent. Nothing may publish meanwhile. Raises OSError (CatalogueFault too).
    """
    indexes = {name(collection) for collection in _collections(store) for name in (root_name, index_name)}
    for collection in _collections(store):
        empty(store, collection, keys)
    others = (head for head in list_all(store, "") if head.name not in indexes and not head.name.startswith(FOLDER))
    return delete_objects(store, others), sorted(indexes)


def delete_objects(store: Store, heads: Iterable[Head]) -> list[DeletedObject]:
    """Delete objects and return them. Raises OSError."""
    deleted = []
    for head in heads:
        store.delete(head.name)
        deleted.append(DeletedObject(head.name, head.size, store.url(head.name)))
    return deleted


def _heads(store: Store, *names: str) -> Iterator[Head]:
    for name in names:
        try:
            yield store.head(name)
        except FileNotFoundError:
            continue


def _collections(store: Store) -> list[str]:
    """Return the names of the collections that have a root, or an index of an earlier release."""
    names = (head.name for head in list_all(store, _COLLECTIONS))
    return sorted({name.split("/")[1] for name in names if name.endswith(_ROOTS) and name.count("/") == 2})
