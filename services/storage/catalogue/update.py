"""Update collections after an asset has changed: write a shard with the asset's new row, then the signed index.

Every attempt reads the catalogue entry after the index, and replaces the index by compare-and-swap. So the last writer
to succeed has seen the newest entry, and the next run completes one that was interrupted.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

from capture2vr.sentences.sentence import say
from capture2vr.storage.catalogue.collection import (
    RETIRED_SHARDS,
    Index,
    Row,
    Shard,
    index_name,
    load_shard,
    parse_envelope,
    read_index,
    row_of,
    shard_name,
    sign_index,
)
from capture2vr.storage.catalogue.compare_and_swap import now_iso, put_mutable, read_mutable, retry_on_conflict
from capture2vr.storage.catalogue.entry import Entry, list_keys, read_entry
from capture2vr.storage.catalogue.faults import (
    CATALOGUE_TRUNCATED,
    SHARD_MISSING,
    SIGNATURE_MISSING,
    SIGNING_KEY_MISSING,
    CatalogueFault,
)
from capture2vr.storage.catalogue.shards import delete_shards, full_shards, split_rows, write_shards
from capture2vr.storage.catalogue.signing import NO_KEYS, Keys
from capture2vr.storage.catalogue.visibility import Visibility, lists
from capture2vr.storage.store import ConditionFailed, Store

_PAGE = 1000  # keys per list request, the most that S3 allows


def update_collections(store: Store, key: str, keys: Keys = NO_KEYS) -> None:
    """Update the asset's row in every collection that its catalogue entry names, or take it out of those that others
    may read and that may not list it. One that is held back is in none.

    Writes nothing where nothing has changed. Raises FileNotFoundError where nothing was published under the key,
    CatalogueFault for a collection that is damaged, has no valid signature, or that this process cannot sign.
    """
    for collection in read_entry(store, key).collections:
        _update_collection(store, collection, key, keys)


def rebuild(store: Store, collection: str, keys: Keys = NO_KEYS) -> Index:
    """Write a collection anew from the catalogue entries, and sign it.

    For assets published before collections existed, after a change of signing keys, or where the collection is damaged.
    The entries on the store are trusted without a check. Raises FileNotFoundError where there is neither such a
    collection nor an asset for it.
    """

    def attempt() -> Index:
        data, etag = read_mutable(store, index_name(collection))
        present = _index_or_none(data, collection)
        visibility = present.visibility if present else None
        rows = _all_rows(store, collection, visibility)
        if not rows and data is None:
            raise FileNotFoundError(f"there is no collection {collection}, and no asset belongs to it")
        _check_unchanged(store, collection, etag)
        # Seconds since 1970 exceed any count of changes: so clients accept the new version even where the old count
        # was lost.
        version = max(present.version + 1 if present else 1, int(time.time()))
        return _replace_all(store, present or Index(collection, 0, "", ()), rows, version, keys, etag)

    return retry_on_conflict(attempt)


def change_visibility(store: Store, collection: str, visibility: Visibility | None, keys: Keys = NO_KEYS) -> Index:
    """Set a collection's visibility, write its list anew and sign it.

    Raises FileNotFoundError where there is no such collection, CatalogueFault as `update_collections`.
    """

    def attempt() -> Index:
        data, etag = read_mutable(store, index_name(collection))
        if data is None:
            raise FileNotFoundError(say("no_collection", name=collection))
        present = _read_current_index(data, collection, keys)
        if present.visibility == visibility:
            return present
        rows = _all_rows(store, collection, visibility)
        _check_unchanged(store, collection, etag)
        # Others must not find by the index the earlier shards, which list what is private.
        earlier = (*present.retired, *(shard.sha256 for shard in present.shards))
        changed = replace(present, visibility=visibility, shards=(), retired=())
        index = _replace_all(store, changed, rows, present.version + 1, keys, etag)
        delete_shards(store, collection, earlier)
        return index

    return retry_on_conflict(attempt)


def remove_row(store: Store, collection: str, key: str, keys: Keys = NO_KEYS) -> None:
    """Remove an asset's row from a collection for good, also from the replaced shards that are still on the store.

    Idempotent. Raises CatalogueFault as `update_collections` does.
    """
    _replace_row(store, collection, key, keys, lambda _: [])


def empty(store: Store, collection: str, keys: Keys = NO_KEYS) -> None:
    """Remove all rows of a collection for good. Its index stays, so that clients see the newer version and obey it.

    Works on a damaged collection too. Idempotent. Raises CatalogueFault where this process cannot sign the index.
    """

    def attempt() -> None:
        data, etag = read_mutable(store, index_name(collection))
        present = _index_or_none(data, collection)
        if present is not None and not present.shards and not present.retired:
            return
        if data is not None and present is not None:
            _read_current_index(data, collection, keys)
        version = max(present.version + 1 if present else 1, int(time.time()))
        visibility = present.visibility if present else None
        _replace_index(store, Index(collection, version, now_iso(), (), (), visibility), (), keys, etag)

    retry_on_conflict(attempt)


def _update_collection(store: Store, collection: str, key: str, keys: Keys) -> None:
    _replace_row(store, collection, key, keys, lambda visibility: _listed_rows([read_entry(store, key)], visibility))


def _replace_row(
    store: Store, collection: str, key: str, keys: Keys, rows_for: Callable[[Visibility | None], list[Row]]
) -> None:
    """Write the asset's row in place of the one that the collection has; without one it is in no earlier shard either.

    rows_for  returns the row for a collection of this visibility, or nothing where there shall be none
    """

    def attempt() -> bool:
        data, etag = read_mutable(store, index_name(collection))
        present = _read_current_index(data, collection, keys)
        wanted = rows_for(present.visibility)
        number, rows = present.shard_number(key), _load_rows(store, present, key, etag)
        others = [each for each in rows if each.key != key]
        new_rows = sorted([*others, *wanted], key=lambda each: each.key)
        if data is not None and new_rows == list(rows):
            return bool(wanted)
        _check_unchanged(store, collection, etag)
        new_shards = write_shards(store, collection, split_rows(new_rows), present.version + 1)
        replaced = [shard.sha256 for shard in present.shards[number : number + 1]]
        shards = (*present.shards[:number], *new_shards, *present.shards[number + 1 :])
        retired = (*present.retired, *replaced)
        index = Index(collection, present.version + 1, now_iso(), shards, retired, present.visibility)
        _replace_index(store, index, new_shards, keys, etag)
        return bool(wanted)

    if not retry_on_conflict(attempt):  # others must not find by the index the earlier shards, which list it
        _forget_retired(store, collection, keys)


def _forget_retired(store: Store, collection: str, keys: Keys) -> None:
    """Delete all retired shards now. Clients that read an older index a moment ago read the new one instead."""

    def attempt() -> None:
        data, etag = read_mutable(store, index_name(collection))
        present = _read_current_index(data, collection, keys)
        if present.retired:
            for sha256 in present.retired:
                store.delete(shard_name(collection, sha256))
            index = replace(present, version=present.version + 1, updated=now_iso(), retired=())
            _replace_index(store, index, (), keys, etag)

    retry_on_conflict(attempt)


def _check_unchanged(store: Store, collection: str, etag: str | None) -> None:
    """Raises ConditionFailed where the index's etag is no longer `etag`.

    Called before shards are written for the next version: another writer of that version may make identical ones.
    """
    try:
        now = store.head(index_name(collection)).etag
    except FileNotFoundError:
        now = None
    if now != etag:
        raise ConditionFailed(f"{index_name(collection)} has changed")


def _read_current_index(data: bytes | None, collection: str, keys: Keys) -> Index:
    """Verify and parse the present index; an empty one where there is none.

    Raises CatalogueFault, also where the index is signed and this process has no key to sign the next one.
    """
    if data is None:
        return Index(collection, 0, "", ())
    if not keys.signers and parse_envelope(data, collection)[1]:
        message = "it is signed, and this process has no key to sign the new version"
        raise CatalogueFault(SIGNING_KEY_MISSING, index_name(collection), message, hint="set STORAGE_SIGNING_KEY")
    try:
        return read_index(data, collection, keys.verification_keys if keys.signers else ())
    except CatalogueFault as fault:
        # Never sign an unsigned index without being asked: an attacker with write access to the store could strip the
        # signature, change the content, and get it signed here.
        if fault.code in (SIGNATURE_MISSING, CATALOGUE_TRUNCATED):
            hint = f"if you trust the store: capture2vr catalogue rebuild --collection {collection}"
            raise CatalogueFault(fault.code, fault.name, fault.message, hint=hint) from None
        raise


def _index_or_none(data: bytes | None, collection: str) -> Index | None:
    """Parse an index without checking its signature; None where there is none, or it cannot be read."""
    try:
        return read_index(data, collection) if data is not None else None
    except CatalogueFault:
        return None


def _load_rows(store: Store, present: Index, key: str, etag: str | None) -> tuple[Row, ...]:
    """Return the rows of the shard that has the key, or would take it.

    Raises ConditionFailed where the shard was deleted because another writer has replaced the index.
    """
    if not present.shards:
        return ()
    try:
        return load_shard(store, present.shards[present.shard_number(key)])
    except CatalogueFault as fault:
        if fault.code == SHARD_MISSING:
            _check_unchanged(store, present.collection, etag)
        raise


def _all_rows(store: Store, collection: str, visibility: Visibility | None) -> list[Row]:
    rows: list[Row] = []
    after = ""
    while page := list_keys(store, after=after, limit=_PAGE):
        entries = (read_entry(store, key) for key in page)
        rows += _listed_rows((each for each in entries if collection in each.collections), visibility)
        after = page[-1]
    return sorted(rows, key=lambda row: row.key)


def _listed_rows(entries: Iterable[Entry], visibility: Visibility | None) -> list[Row]:
    """Return the rows of those assets that a collection of this visibility lists, without those that are held back."""
    return [row_of(each) for each in entries if lists(visibility, each.visibility) and not each.held]


def _replace_all(
    store: Store, present: Index, rows: Sequence[Row], version: int, keys: Keys, etag: str | None
) -> Index:
    """Write an index that lists these rows alone, in place of the present one."""
    new_shards = write_shards(store, present.collection, full_shards(rows), version)
    retired = (*present.retired, *(shard.sha256 for shard in present.shards))
    index = Index(present.collection, version, now_iso(), tuple(new_shards), retired, present.visibility)
    return _replace_index(store, index, new_shards, keys, etag)


def _replace_index(store: Store, index: Index, new_shards: Sequence[Shard], keys: Keys, etag: str | None) -> Index:
    """Write `index` in place of the one that was read with `etag`, deleting the oldest retired shards.

    Raises ConditionFailed where somebody else wrote it meanwhile; `new_shards` are then deleted.
    """
    over = max(0, len(index.retired) - RETIRED_SHARDS)
    # Deleted before the index forgets their names. That is safe: no index ever lists a retired shard again.
    delete_shards(store, index.collection, index.retired[:over])
    index = replace(index, retired=index.retired[over:])
    try:
        put_mutable(store, index_name(index.collection), sign_index(index, keys.signers), etag)
    except ConditionFailed:
        _delete_unlisted(store, index.version, index.collection, new_shards)
        raise
    return index


def _delete_unlisted(store: Store, version: int, collection: str, new_shards: Sequence[Shard]) -> None:
    """Delete the shards of a version that another writer has written, unless its index lists identical ones.

    Each version is written only once, so no later index will list them. A put whose answer was lost looks like a
    conflict too; then the index on the store is ours and lists them.
    """
    winner = _index_or_none(read_mutable(store, index_name(collection))[0], collection)
    if winner is not None and winner.version >= version:
        known = {*(shard.sha256 for shard in winner.shards), *winner.retired}
        delete_shards(store, collection, [shard.sha256 for shard in new_shards if shard.sha256 not in known])
