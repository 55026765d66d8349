"""Commit rows to a collection: write the changed shards and the nodes above them, then the signed root.

The root is replaced by compare-and-swap, and asset entries are read after it. So the last writer to succeed has seen
the newest entry, and the next run completes one that was interrupted. Replaced objects stay for two minutes, for
readers that have read an older root.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

from capture2vr.process.at_once import at_once
from capture2vr.storage.catalogue.collection import Row, load_shard, row_of
from capture2vr.storage.catalogue.compare_and_swap import (
    etag_of,
    now_iso,
    put_mutable,
    read_mutable,
    retry_on_conflict,
)
from capture2vr.storage.catalogue.entry import Entry, read_entry
from capture2vr.storage.catalogue.faults import (
    CATALOGUE_TRUNCATED,
    SHARD_MISSING,
    SIGNATURE_MISSING,
    SIGNING_KEY_MISSING,
    CatalogueFault,
)
from capture2vr.storage.catalogue.retired import (
    delete_lists,
    delete_objects,
    due_lists,
    with_retired_aside,
)
from capture2vr.storage.catalogue.root import (
    Index,
    index_name,
    index_or_none,
    parse_envelope,
    read_index,
    root_name,
    sign_index,
)
from capture2vr.storage.catalogue.signing import Keys
from capture2vr.storage.catalogue.tree import Draft, load_node, path_to, shards_of
from capture2vr.storage.catalogue.visibility import Visibility, lists
from capture2vr.storage.store import ConditionFailed, Store

_log = logging.getLogger(__name__)

RowsFor = Callable[[Visibility | None], Mapping[str, Row | None]]
"""Returns the rows of assets, by key, as a collection of this visibility lists them; None: not at all."""

MOST_FLAT = 5000
"""Rows of a collection that has a flat index, for clients of earlier releases."""
_OURS: set[str] = set()
"""Etags of flat indexes that no earlier release has written."""
_MOST_ETAGS = 1000


@dataclass(frozen=True, slots=True)
class Committed:
    """A collection after a commit, and whether an asset has left it."""

    index: Index
    has_left: bool


def commit(store: Store, collection: str, rows_for: RowsFor, keys: Keys) -> Index:
    """Put assets' rows into a collection, or take them out, against other writers; return the new root.

    Writes nothing where nothing changes. What leaves the collection is in no earlier object either, by which others
    could find it. Raises CatalogueFault for a collection that is damaged, has no valid signature, or that this process
    cannot sign.
    """
    return settle(store, collection, keys, retry_on_conflict(lambda: commit_once(store, collection, rows_for, keys)))


def settle(store: Store, collection: str, keys: Keys, done: Committed) -> Index:
    """Delete what a commit has retired where an asset has left by it, and return the newest root that is known."""
    return forget_retired(store, collection, keys) if done.has_left else done.index


def commit_once(store: Store, collection: str, rows_for: RowsFor, keys: Keys) -> Committed:
    """Make one attempt to commit. Raises ConditionFailed where somebody else wrote the collection meanwhile."""
    present, etag = read_current(store, collection, keys)
    may_be_older = etag is not None and present.count <= MOST_FLAT
    elsewhere, version = _changed_by_earlier_release(store, present, keys) if may_be_older else ((), 0)
    rows = {**rows_of_entries(store, elsewhere)(present.visibility), **rows_for(present.visibility)}
    draft = Draft(store, collection, commit_id(present, rows))
    try:
        parts, depth = draft.change(present, rows)
    except CatalogueFault as fault:
        if fault.code == SHARD_MISSING:
            check_unchanged(store, collection, etag)
        raise
    if parts == present.parts:
        return Committed(present, False)
    index = replace(
        present,
        version=max(present.version, version) + 1,
        updated=now_iso(),
        parts=parts,
        depth=depth,
        commit=draft.commit,
        retired=(*present.retired, *sorted(draft.replaced)),
    )
    return Committed(write_root(index, draft, keys, etag), draft.has_left)


def commit_id(present: Index, rows: Mapping[str, Row | None]) -> str:
    """Return the id of the commit that makes these changes to a collection.

    Who repeats a commit that was cut short makes the same objects, so that it leaves none behind.
    """
    change = repr((present.version, present.commit, sorted(rows.items())))
    return hashlib.sha256(change.encode()).hexdigest()[:16]


def listed_row(entry: Entry, visibility: Visibility | None) -> Row | None:
    """Return an asset's row as a collection of this visibility lists it; None if it does not, or it is held back."""
    return row_of(entry) if lists(visibility, entry.visibility) and not entry.held else None


def rows_of_entries(store: Store, asset_keys: Sequence[str]) -> RowsFor:
    """Return a function that makes the rows of assets from their entries, as they are when it is called.

    An asset whose entry is damaged keeps the row that it has: others of the batch are not held up by it.
    """

    def row(key: str, visibility: Visibility | None) -> dict[str, Row | None]:
        try:
            return {key: listed_row(read_entry(store, key), visibility)}
        except FileNotFoundError:  # deleted since
            return {key: None}
        except CatalogueFault as fault:
            _log.warning("the row of asset %s stays as it is: %s", key, fault)
            return {}

    def rows(visibility: Visibility | None) -> dict[str, Row | None]:
        found = at_once([partial(row, key, visibility) for key in asset_keys])
        return {key: each for some in found for key, each in some.items()}

    return rows


def read_current(store: Store, collection: str, keys: Keys) -> tuple[Index, str | None]:
    """Verify and parse the present root, and return it with its etag; an empty one where there is none.

    A collection that an earlier release has written begins with its flat index. Raises CatalogueFault, also where it is
    signed and this process has no key to sign the next version.
    """
    data, etag = _read_root_or_index(store, collection)
    if data is None:
        return Index(collection, 0, "", ()), None
    if not keys.signers and parse_envelope(data, collection)[1]:
        message = "it is signed, and this process has no key to sign the new version"
        raise CatalogueFault(SIGNING_KEY_MISSING, root_name(collection), message, hint="set STORAGE_SIGNING_KEY")
    try:
        return read_index(data, collection, keys.verification_keys if keys.signers else ()), etag
    except CatalogueFault as fault:
        # Never sign an unsigned root without being asked: an attacker with write access to the store could strip the
        # signature, change the content, and get it signed here.
        if fault.code in (SIGNATURE_MISSING, CATALOGUE_TRUNCATED):
            hint = f"if you trust the store: capture2vr catalogue rebuild --collection {collection}"
            raise CatalogueFault(fault.code, fault.name, fault.message, hint=hint) from None
        raise


def flat_of_earlier_release(store: Store, collection: str, keys: Keys) -> Index | None:
    """Return the flat index if a worker of an earlier release has written it; None where this one has, or nobody, or
    where it cannot be trusted.
    """
    name = index_name(collection)
    try:
        etag = store.head(name).etag
        if etag in _OURS:
            return None
        data = store.get(name)
        flat = read_index(data, collection, keys.verification_keys if keys.signers else ())
    except FileNotFoundError:
        return None
    except CatalogueFault:  # forged, damaged, or the end of it
        flat = None
    if flat is not None and not flat.commit:
        return flat
    if len(_OURS) > _MOST_ETAGS:
        _OURS.clear()
    _OURS.add(etag)
    return None


def _changed_by_earlier_release(store: Store, present: Index, keys: Keys) -> tuple[Sequence[str], int]:
    """Return the keys of rows that a worker of an earlier release, beside this one, has changed in the flat index, and
    that index's version.
    """
    flat = flat_of_earlier_release(store, present.collection, keys)
    if flat is None:
        return (), 0
    theirs = {row.key: row for row in rows_of_index(store, flat)}
    ours = {row.key: row for row in rows_of_index(store, present)}
    return [key for key in {**ours, **theirs} if ours.get(key) != theirs.get(key)], flat.version


def read_unchecked(store: Store, collection: str) -> tuple[Index | None, str | None, bool]:
    """Return root, its etag, and whether there is any root or index, without checking signatures; the root is None
    where it cannot be read.
    """
    data, etag = _read_root_or_index(store, collection)
    return index_or_none(data, collection), etag, data is not None


def _read_root_or_index(store: Store, collection: str) -> tuple[bytes | None, str | None]:
    """Read the root and its etag; without one, the flat index that an earlier release has written, and None."""
    data, etag = read_mutable(store, root_name(collection))
    return (data, etag) if data is not None else (read_mutable(store, index_name(collection))[0], None)


def write_root(index: Index, draft: Draft, keys: Keys, etag: str | None) -> Index:
    """Write the objects of a draft, and then the root in place of the one that was read with `etag`.

    Deletes what was retired two minutes ago. Raises ConditionFailed where somebody else wrote the root meanwhile; the
    draft's objects are then deleted.
    """
    store = draft.store
    index = with_retired_aside(index, draft)
    due = due_lists(index)
    index = replace(index, lists=tuple(each for each in index.lists if each not in due))

    def put(name: str) -> None:
        store.put(name, draft.written[name], content_type="application/json")

    # Deleted before the root forgets their names. That is safe: no root ever lists a retired object again.
    at_once([*(partial(put, name) for name in draft.written), partial(delete_lists, store, due)])
    try:
        put_mutable(store, root_name(index.collection), sign_index(index, keys.signers), etag)
    except ConditionFailed:
        _delete_unlisted(index, draft)
        raise
    return index


def forget_retired(store: Store, collection: str, keys: Keys) -> Index:
    """Delete all retired objects now. Clients that read an older root a moment ago read the new one instead."""

    def attempt() -> Index:
        present, etag = read_current(store, collection, keys)
        if not present.retired and not present.lists:
            return present
        delete_objects(store, present.retired)
        delete_lists(store, present.lists)
        draft = Draft(store, collection, commit_id(present, {}))
        changed = replace(present, version=present.version + 1, updated=now_iso(), commit=draft.commit)
        return write_root(replace(changed, retired=(), lists=()), draft, keys, etag)

    return retry_on_conflict(attempt)


def rows_of_index(store: Store, index: Index) -> list[Row]:
    """Read all rows of a collection. Raises CatalogueFault."""
    shards = list(shards_of(index, partial(load_node, store, index.collection)))
    return [row for rows in at_once([partial(load_shard, store, shard) for shard in shards]) for row in rows]


def check_unchanged(store: Store, collection: str, etag: str | None) -> None:
    """Raises ConditionFailed where the root's etag is no longer `etag`."""
    if etag_of(store, root_name(collection)) != etag:
        raise ConditionFailed(f"{root_name(collection)} has changed")


def _delete_unlisted(index: Index, draft: Draft) -> None:
    """Delete the objects of a version that another writer has written.

    A put whose answer was lost looks like a conflict too, as does another writer's same change: then the root on the
    store lists them.
    """
    winner = index_or_none(read_mutable(draft.store, root_name(index.collection))[0], index.collection)
    if winner is None:
        return
    load = partial(load_node, draft.store, index.collection)
    with suppress(CatalogueFault):  # what cannot be told stays, and takes space
        listed = {part.name for first in draft.firsts.values() for part in path_to(winner, first, load)}
        delete_objects(draft.store, draft.written.keys() - listed - {name for _, name in winner.lists})
