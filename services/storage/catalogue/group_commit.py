"""List assets in a collection together with those of other publishers: one of them commits what all wait for.

A publisher that is alone commits for itself. One that finds others at work puts a note of its asset into
`collections/<name>/waiting/`; whoever holds the lease `collections/<name>/committer.json` commits all notes at once and
deletes them, in any process, gateway or worker. Who holds it renews it with every commit; a lease that nobody has
renewed for a while, as seen by the clock of who waits, is taken over. Safety rests on the root's compare-and-swap
alone: a committer that wakes up late, or a second one, finds the root changed and begins again.
"""

from __future__ import annotations

import random
import secrets
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from capture2vr.storage.catalogue.commit import (
    commit,
    commit_once,
    rows_of_entries,
    settle,
)
from capture2vr.storage.catalogue.compare_and_swap import canonical_json, etag_of
from capture2vr.storage.catalogue.earlier_forms import keep_earlier_forms
from capture2vr.storage.catalogue.entry import check_collection
from capture2vr.storage.catalogue.retired import delete_objects
from capture2vr.storage.catalogue.signing import Keys
from capture2vr.storage.store import NO_CACHE, ConditionFailed, Store

_ABANDONED_S = 15.0  # a lease that has not changed for so long is nobody's
_LEADS_S = 2.0  # how long a publisher commits for others, at least one batch
_PATIENCE_S = 120.0  # how long a publisher waits in all
_BATCH = 128  # notes that one commit takes, the oldest first
_POLL_S = 0.03


def commit_in_turn(store: Store, collection: str, key: str, keys: Keys) -> None:
    """Update an asset's row in a collection, alone or with those of others, and the forms for earlier clients.

    Raises CatalogueFault as `commit`, OSError where the store fails or others keep the collection busy for minutes.
    """
    lease = _Lease(store, f"collections/{check_collection(collection)}/committer.json")
    if not lease.is_held():
        with suppress(ConditionFailed):
            done = commit_once(store, collection, rows_of_entries(store, [key]), keys)
            keep_earlier_forms(store, collection, keys, settle(store, collection, keys, done))
            return
    _wait(store, collection, key, keys, lease)


@dataclass
class _Lease:
    """The right to commit for others: an object that its holder renews."""

    store: Store
    name: str
    etag: str = ""
    _seen: tuple[str, float] = ("", 0.0)

    def is_held(self) -> bool:
        """Whether anybody seems to hold it."""
        return etag_of(self.store, self.name) is not None

    def take(self) -> bool:
        """Take the lease if it is free or abandoned, and return whether it is ours now."""
        found = etag_of(self.store, self.name)
        if found and found != self._seen[0]:
            self._seen = (found, time.monotonic())
        return (not found or time.monotonic() - self._seen[1] > _ABANDONED_S) and self._write(found)

    def renew(self) -> bool:
        """Renew the lease, and return whether it still was ours."""
        return self._write(self.etag)

    def release(self) -> None:
        """Let others have it."""
        with suppress(OSError):  # it is taken over when nobody renews it
            if etag_of(self.store, self.name) == self.etag:
                self.store.delete(self.name)

    def _write(self, instead_of: str | None) -> bool:
        data = canonical_json({"holder": secrets.token_hex(8)})
        condition: dict[str, Any] = {"if_match": instead_of} if instead_of else {"if_absent": True}
        try:
            head = self.store.put(self.name, data, content_type="application/json", cache_control=NO_CACHE, **condition)
            self.etag = head.etag
        except (ConditionFailed, FileNotFoundError):
            return False
        return True


def _wait(store: Store, collection: str, key: str, keys: Keys, lease: _Lease) -> None:
    """Leave a note, and wait until somebody has committed it: this process, where nobody else does."""
    note = f"collections/{collection}/waiting/{key}.{secrets.token_hex(6)}.json"
    store.put(note, b"{}", content_type="application/json", cache_control=NO_CACHE)
    deadline = time.monotonic() + _PATIENCE_S
    try:
        while etag_of(store, note) is not None:
            if lease.take():
                _lead(store, collection, keys, lease)
            elif time.monotonic() > deadline:
                raise OSError(f"others have kept the collection {collection} busy for minutes; publish again")
            else:
                time.sleep(_POLL_S * random.uniform(0.5, 1.5))
    except BaseException:
        store.delete(note)
        raise


def _lead(store: Store, collection: str, keys: Keys, lease: _Lease) -> None:
    """Commit what waits, batch by batch, for a while; then bring the forms for earlier clients up to date, once."""
    until = time.monotonic() + _LEADS_S
    index = None
    try:
        while notes := store.list(f"collections/{collection}/waiting/"):
            oldest = [head.name for head in sorted(notes, key=lambda head: head.modified)[:_BATCH]]
            assets = rows_of_entries(store, sorted({name.rpartition("/")[2].rsplit(".", 2)[0] for name in oldest}))
            index = commit(store, collection, assets, keys)
            delete_objects(store, oldest)
            if time.monotonic() > until or not lease.renew():
                break
    finally:
        lease.release()
    if index is not None:
        keep_earlier_forms(store, collection, keys, index)
