"""Keep the forms of a collection that clients of earlier releases read, and Unity alone: small collections have them.

A flat index lists all shards, and Unity's catalogues all assets: what they cost grows with the collection. So they are
made from the tree: at once while they are small, then at most every half a minute, and not at all beyond 5,000 assets.
"""

from __future__ import annotations

import atexit
import logging
import threading
from contextlib import suppress
from dataclasses import asdict
from datetime import UTC, datetime
from functools import partial
from typing import Any

from capture2vr.storage.catalogue.commit import (
    MOST_FLAT,
    commit,
    flat_of_earlier_release,
    read_current,
    rows_of_index,
)
from capture2vr.storage.catalogue.compare_and_swap import put_mutable, read_mutable, retry_on_conflict
from capture2vr.storage.catalogue.faults import CatalogueFault
from capture2vr.storage.catalogue.root import FLAT_SCHEMA, SCHEMA, Index, index_name, index_or_none, root_name, seal
from capture2vr.storage.catalogue.signing import Keys
from capture2vr.storage.catalogue.tree import load_node, shards_of
from capture2vr.storage.catalogue.unity_update import delete_unity_catalogues, write_unity_catalogues
from capture2vr.storage.store import NO_CACHE, Store

_AT_ONCE_ROWS = 250  # up to so many they are written with every change
_EVERY_S = 30.0
_SEE = b'\\"see\\":'  # in the JSON text within the envelope

_log = logging.getLogger(__name__)
_waiting: dict[str, threading.Timer] = {}
_lock = threading.Lock()


def keep_earlier_forms(store: Store, collection: str, keys: Keys, index: Index) -> None:
    """Bring the forms for earlier clients up to date with a root that has just been written, or soon."""
    if index.count <= _AT_ONCE_ROWS or index.count > MOST_FLAT or _is_old(store, collection):
        write_earlier_forms(store, collection, keys, index)
    else:
        _write_later(store, collection, keys)


def write_earlier_forms(store: Store, collection: str, keys: Keys, index: Index) -> None:
    """Write the flat index and Unity's catalogues from the tree, or delete them where the collection is too large.

    Writes nothing where nothing has changed. Raises OSError (CatalogueFault too) where the store fails.
    """

    if index.count > MOST_FLAT:
        _end_earlier_forms(store, collection, keys, index)
        return

    def attempt() -> None:
        data, etag = read_mutable(store, index_name(collection))  # before the root: the last writer has the newest
        flat, current = index_or_none(data, collection), read_current(store, collection, keys)[0]
        if flat is not None and not flat.commit and flat.version != current.version:  # an earlier release wrote it
            current = commit(store, collection, lambda _: {}, keys)
        if flat is None or flat.commit != current.commit:
            put_mutable(store, index_name(collection), _flat_index(store, current, keys), etag)

    retry_on_conflict(attempt)
    write_unity_catalogues(store, collection, lambda: rows_of_index(store, read_current(store, collection, keys)[0]))


def _end_earlier_forms(store: Store, collection: str, keys: Keys, index: Index) -> None:
    """Put a document that earlier clients refuse in place of the flat index, once, and delete Unity's catalogues."""
    name = index_name(collection)
    with suppress(FileNotFoundError):
        if _SEE in store.get(name):
            return
    document = {**_facts(index), "schema": SCHEMA, "see": root_name(collection)}
    delete_unity_catalogues(store, collection)
    store.put(name, seal(document, keys.signers), content_type="application/json", cache_control=NO_CACHE)


def take_over_flat(store: Store, collection: str, keys: Keys) -> None:
    """Take over what a worker of an earlier release has listed in the flat index alone, as during an upgrade.

    Costs one call while there is none. Raises OSError (CatalogueFault too), also where this process cannot sign.
    """
    if flat_of_earlier_release(store, collection, keys) is None:
        return
    index, etag = read_current(store, collection, keys)
    if etag is not None:
        write_earlier_forms(store, collection, keys, index)


def flat_index(store: Store, collection: str, keys: Keys, index: Index) -> bytes:
    """Return the signed flat index of a collection with this root, written anew where it is older, if this process can.

    Raises FileNotFoundError, OSError (CatalogueFault too).
    """
    name = index_name(collection)
    data, _ = read_mutable(store, name)
    flat = index_or_none(data, collection)
    if data is not None and flat is not None and flat.commit in ("", index.commit):
        return data
    with suppress(CatalogueFault):  # who cannot sign has what there is
        write_earlier_forms(store, collection, keys, read_current(store, collection, keys)[0])
    return store.get(name)


def _flat_index(store: Store, index: Index, keys: Keys) -> bytes:
    """Return the signed flat index of a tree."""
    shards = [asdict(shard) for shard in shards_of(index, partial(load_node, store, index.collection))]
    return seal({**_facts(index), "schema": FLAT_SCHEMA, "shards": shards, "retired": []}, keys.signers)


def _facts(index: Index) -> dict[str, Any]:
    return {
        "collection": index.collection,
        "version": index.version,
        "updated": index.updated,
        "commit": index.commit,
        "visibility": index.visibility,
    }


def _is_old(store: Store, collection: str) -> bool:
    """Whether the flat index was written some time ago, or never; a clock that is wrong makes it old."""
    try:
        modified = store.head(index_name(collection)).modified
    except FileNotFoundError:
        return True
    return abs((datetime.now(UTC) - modified).total_seconds()) > _EVERY_S


def _write_later(store: Store, collection: str, keys: Keys) -> None:
    """Write the forms in half a minute, or when the process ends, once for all changes until then."""
    address = store.url(index_name(collection))

    def write() -> None:
        with _lock:
            _waiting.pop(address, None)
        try:
            write_earlier_forms(store, collection, keys, read_current(store, collection, keys)[0])
        except Exception:  # noqa: BLE001 - the next change tries again
            _log.exception("the forms of collection %s for earlier clients were not written", collection)

    with _lock:
        if address not in _waiting:
            _waiting[address] = timer = threading.Timer(_EVERY_S, write)
            timer.daemon = True
            timer.start()


@atexit.register
def write_waiting_forms() -> None:
    """Write now what waits to be written."""
    with _lock:
        timers = list(_waiting.values())
    for timer in timers:
        timer.cancel()
        with suppress(Exception):
            timer.function(*timer.args, **timer.kwargs)
