"""Update collections after an asset or their visibility has changed, or write them anew."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

from capture2vr.sentences.sentence import say
from capture2vr.storage.catalogue.collection import Row
from capture2vr.storage.catalogue.commit import (
    check_unchanged,
    commit,
    commit_id,
    listed_row,
    read_current,
    read_unchecked,
    write_root,
)
from capture2vr.storage.catalogue.compare_and_swap import now_iso, read_mutable, retry_on_conflict
from capture2vr.storage.catalogue.earlier_forms import write_earlier_forms
from capture2vr.storage.catalogue.entry import list_keys, read_entry
from capture2vr.storage.catalogue.group_commit import commit_in_turn
from capture2vr.storage.catalogue.retired import all_objects, delete_objects
from capture2vr.storage.catalogue.root import Index, index_name, index_or_none
from capture2vr.storage.catalogue.signing import NO_KEYS, Keys
from capture2vr.storage.catalogue.tree import Draft
from capture2vr.storage.catalogue.visibility import Visibility
from capture2vr.storage.store import Store

_PAGE = 1000  # keys per list request, the most that S3 allows


def update_collections(store: Store, key: str, keys: Keys = NO_KEYS) -> None:
    """Update the asset's row in every collection that its catalogue entry names, or take it out of those that others
    may read and that may not list it. One that is held back is in none. Unity's catalogues follow.

    Writes nothing where nothing has changed. Raises FileNotFoundError where nothing was published under the key,
    CatalogueFault for a collection that is damaged, has no valid signature, or that this process cannot sign.
    """
    for collection in read_entry(store, key).collections:
        commit_in_turn(store, collection, key, keys)


def rebuild(store: Store, collection: str, keys: Keys = NO_KEYS) -> Index:
    """Write a collection anew from the catalogue entries, and sign it.

    For assets published before collections existed, after a change of signing keys, or where the collection is damaged.
    The entries on the store are trusted without a check. Raises FileNotFoundError where there is neither such a
    collection nor an asset for it.
    """

    def attempt() -> Index:
        present, etag, exists = read_unchecked(store, collection)
        visibility = present.visibility if present else None
        rows = _all_rows(store, collection, visibility)
        if not rows and not exists:
            raise FileNotFoundError(f"there is no collection {collection}, and no asset belongs to it")
        # Seconds since 1970 exceed any count of changes: so clients accept the new version even where the old count
        # was lost.
        version = max(present.version + 1 if present else 1, int(time.time()))
        return _replace_all(store, present or Index(collection, 0, "", ()), rows, version, keys, etag)

    index = retry_on_conflict(attempt)
    write_earlier_forms(store, collection, keys, index)
    return index


def set_collection_visibility(store: Store, name: str, visibility: Visibility | None, keys: Keys = NO_KEYS) -> Index:
    """Set a collection's visibility, write its list anew, without what it may not list any more, and sign it.

    Idempotent. Raises FileNotFoundError where there is no such collection, OSError (CatalogueFault too) as
    `update_collections`.
    """

    def attempt() -> Index:
        present, etag = read_current(store, name, keys)
        if not present.version:
            raise FileNotFoundError(say("no_collection", name=name))
        if present.visibility == visibility:
            return present
        rows = _all_rows(store, name, visibility)
        # Others must not find by the root the earlier objects, which list what is private.
        earlier = all_objects(store, present)
        changed = replace(present, visibility=visibility, parts=(), retired=(), lists=())
        index = _replace_all(store, changed, rows, present.version + 1, keys, etag)
        delete_objects(store, earlier)
        return index

    index = retry_on_conflict(attempt)
    write_earlier_forms(store, name, keys, index)
    return index


def remove_row(store: Store, collection: str, key: str, keys: Keys = NO_KEYS) -> None:
    """Remove an asset's row from a collection for good, also from the replaced shards that are still on the store.

    Idempotent. Raises CatalogueFault as `update_collections` does.
    """
    index = commit(store, collection, lambda _: {key: None}, keys)
    write_earlier_forms(store, collection, keys, index)


def empty(store: Store, collection: str, keys: Keys = NO_KEYS) -> None:
    """Remove all rows of a collection for good. Its root stays, so that clients see the newer version and obey it.

    Works on a damaged collection too. Idempotent. Raises CatalogueFault where this process cannot sign the root.
    """

    def attempt() -> Index:
        present, etag, _ = read_unchecked(store, collection)
        if present is not None:
            read_current(store, collection, keys)
            if not (present.parts or present.retired or present.lists):
                return present
        version = max(present.version + 1 if present else 1, int(time.time()))
        visibility = present.visibility if present else None
        index = Index(collection, version, now_iso(), (), visibility=visibility)
        draft = Draft(store, collection, commit_id(index, {}))
        return write_root(replace(index, commit=draft.commit), draft, keys, etag)

    index = retry_on_conflict(attempt)
    flat = index_or_none(read_mutable(store, index_name(collection))[0], collection)
    if flat is None or flat.commit != index.commit:
        write_earlier_forms(store, collection, keys, index)


def _all_rows(store: Store, collection: str, visibility: Visibility | None) -> list[Row]:
    rows: list[Row] = []
    after = ""
    while page := list_keys(store, after=after, limit=_PAGE):
        entries = (read_entry(store, key) for key in page)
        rows += filter(None, (listed_row(each, visibility) for each in entries if collection in each.collections))
        after = page[-1]
    return sorted(rows, key=lambda row: row.key)


def _replace_all(
    store: Store, present: Index, rows: Sequence[Row], version: int, keys: Keys, etag: str | None
) -> Index:
    """Write a tree of these rows alone in place of the present one."""
    check_unchanged(store, present.collection, etag)
    draft = Draft(store, present.collection, commit_id(present, {row.key: row for row in rows}))
    parts, depth = draft.build(rows)
    earlier = [each for each in all_objects(store, present) if "/retired." not in each]
    index = replace(present, version=version, updated=now_iso(), parts=parts, depth=depth, commit=draft.commit)
    return write_root(replace(index, retired=tuple(earlier), lists=()), draft, keys, etag)
