"""Taking an asset out of sight and bringing it back: a mark in its entry and in its collections; every file stays."""

from __future__ import annotations

from services.storage.catalogue import Entry, check_key, entry, entry_name
from services.storage.collect import enter
from services.storage.signing import NO_KEYS, Keys
from services.storage.store import Store
from services.storage.unity.keep import keep
from services.storage.writing import encoded, now_iso, put_mutable, until_won


def remove(store: Store, key: str, keys: Keys = NO_KEYS) -> Entry:
    """Take an asset out of sight until it is restored or a new version is published; the entry as it is then.

    Doing it twice changes nothing more. Raises FileNotFoundError for an unknown key, OSError (CatalogueFault too) when
    the store fails; after that, remove again.
    """
    return _mark(store, key, keys, removed=True)


def restore(store: Store, key: str, keys: Keys = NO_KEYS) -> Entry:
    """Bring a removed asset back as it was. Idempotent, and raises, as `remove` is and does."""
    return _mark(store, key, keys, removed=False)


def _mark(store: Store, key: str, keys: Keys, *, removed: bool) -> Entry:
    def attempt() -> None:
        present = entry(store, key)
        if present.removed != removed:
            now = now_iso()
            document = {**present.document, "updated": now, "removed": now if removed else None}
            put_mutable(store, entry_name(key), encoded(document), present.etag)

    check_key(key)
    until_won(attempt)
    enter(store, key, keys)
    keep(store, key)
    return entry(store, key)
