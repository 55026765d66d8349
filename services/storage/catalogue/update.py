"""Keeping collections: the row of an asset is brought up to its catalogue entry, the index after the shard.

Every step reads the entry after the index and replaces the index only as it was read. So whoever wins last has seen
the newest entry, and a run that was cut short anywhere is completed by the next.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import suppress

from services.storage.bundle import sha256_hex
from services.storage.catalogue import entry, list_keys
from services.storage.collection import (
    RETIRED,
    SHARD_ROWS,
    Index,
    Row,
    Shard,
    index_name,
    listed,
    load_shard,
    opened,
    read_index,
    row_of,
    sealed,
    shard_data,
    shard_name,
)
from services.storage.faults import (
    CATALOGUE_TRUNCATED,
    SHARD_MISSING,
    SIGNATURE_MISSING,
    SIGNING_KEY_MISSING,
    CatalogueFault,
)
from services.storage.signing import NO_KEYS, Keys
from services.storage.store import ConditionFailed, Store
from services.storage.writing import now_iso, put_mutable, read_mutable, until_won

_PAGE = 1000  # keys at once, which is what S3 lists in one request


def enter(store: Store, key: str, keys: Keys = NO_KEYS) -> None:
    """Bring the rows of an asset up to its catalogue entry, in every collection that the entry names.

    Writes nothing where all is as it should be. Raises FileNotFoundError where nothing was published under the key,
    CatalogueFault for a collection that cannot be built upon or that this process cannot sign.
    """
    for collection in entry(store, key).collections:
        _enter(store, collection, key, keys)


def rebuild(store: Store, collection: str, keys: Keys = NO_KEYS) -> Index:
    """Write a collection anew from the catalogue entries, and sign it: for assets older than the collection, for other
    signing keys, and where it was damaged. What stands on the store is believed.

    Raises FileNotFoundError where there is no such collection and no asset for it.
    """

    def attempt() -> Index:
        data, etag = read_mutable(store, index_name(collection))
        present = _present_or_none(data, collection)
        rows = _all_rows(store, collection)
        if not rows and data is None:
            raise FileNotFoundError(f"no asset belongs to a collection {collection}")
        _check_unchanged(store, collection, etag)
        # Seconds since 1970 exceed what a count of changes comes to: clients take the new count even where the old
        # one was lost.
        version = max(present.version + 1 if present else 1, int(time.time()))
        parts = [rows[start : start + SHARD_ROWS] for start in range(0, len(rows), SHARD_ROWS)]
        retired = (*present.retired, *(shard.sha256 for shard in present.shards)) if present else ()
        made = _made(store, collection, parts, version)
        return _replace(store, Index(collection, version, now_iso(), tuple(made), retired), made, keys, etag)

    return until_won(attempt)


def _enter(store: Store, collection: str, key: str, keys: Keys) -> None:
    def attempt() -> None:
        data, etag = read_mutable(store, index_name(collection))
        present = _checked(data, collection, keys)
        row = row_of(entry(store, key))
        place, rows = present.place(key), _rows(store, present, key, etag)
        others = [each for each in rows if each.key != key]
        if row in rows:
            return
        _check_unchanged(store, collection, etag)
        parts = _parts(sorted([*others, row], key=lambda each: each.key))
        made = _made(store, collection, parts, present.version + 1)
        gone = [shard.sha256 for shard in present.shards[place : place + 1]]
        shards = (*present.shards[:place], *made, *present.shards[place + 1 :])
        index = Index(collection, present.version + 1, now_iso(), shards, (*present.retired, *gone))
        _replace(store, index, made, keys, etag)

    until_won(attempt)


def _check_unchanged(store: Store, collection: str, etag: str | None) -> None:
    """That the tag is still the index's, so that it was when the content was read. Raises ConditionFailed.

    Shards are made for the version behind that content; a rival at the same version may make the very same ones.
    """
    try:
        now = store.head(index_name(collection)).etag
    except FileNotFoundError:
        now = None
    if now != etag:
        raise ConditionFailed(f"{index_name(collection)} has changed")


def _checked(data: bytes | None, collection: str, keys: Keys) -> Index:
    """The index to build upon: empty where there is none. Raises CatalogueFault, also where it was signed and would
    not be any more.
    """
    if data is None:
        return Index(collection, 0, "", ())
    if not keys.signers and opened(data, collection)[1]:
        message = "it is signed, and this process has no key to sign it anew"
        raise CatalogueFault(SIGNING_KEY_MISSING, index_name(collection), message, hint="set STORAGE_SIGNING_KEY")
    try:
        return read_index(data, collection, keys.believed if keys.signers else ())
    except CatalogueFault as fault:
        # Not signed by itself: whoever can write to the store could strip the signature and have us sign what is left.
        if fault.code in (SIGNATURE_MISSING, CATALOGUE_TRUNCATED):
            hint = f"if you trust the store: capture2vr catalogue rebuild --collection {collection}"
            raise CatalogueFault(fault.code, fault.name, fault.message, hint=hint) from None
        raise


def _present_or_none(data: bytes | None, collection: str) -> Index | None:
    """What the index says, whoever has signed it; None where there is none, or nothing can be read from it."""
    try:
        return read_index(data, collection) if data is not None else None
    except CatalogueFault:
        return None


def _rows(store: Store, present: Index, key: str, etag: str | None) -> tuple[Row, ...]:
    """The rows beside which a key stands. Raises ConditionFailed where they went because the index was replaced."""
    if not present.shards:
        return ()
    try:
        return load_shard(store, present.shards[present.place(key)])
    except CatalogueFault as fault:
        if fault.code == SHARD_MISSING:
            _check_unchanged(store, present.collection, etag)
        raise


def _all_rows(store: Store, collection: str) -> list[Row]:
    rows: list[Row] = []
    after = ""
    while page := list_keys(store, after=after, limit=_PAGE):
        entries = (entry(store, key) for key in page)
        rows += [row_of(each) for each in entries if collection in each.collections]
        after = page[-1]
    return sorted(rows, key=lambda row: row.key)


def _parts(rows: Sequence[Row]) -> list[Sequence[Row]]:
    """One shard, or two halves. None is ever merged with its neighbour: rows stay, those of removed assets too."""
    if len(rows) <= SHARD_ROWS:
        return [rows]
    half = len(rows) // 2
    return [rows[:half], rows[half:]]


def _made(store: Store, collection: str, parts: Sequence[Sequence[Row]], version: int) -> list[Shard]:
    """Shards that are on the store, and not yet in the index."""
    shards = []
    for rows in parts:
        data = shard_data(rows, version)
        shards.append(listed(collection, rows, data))
        store.put(shard_name(collection, sha256_hex(data)), data, content_type="application/json")
    return shards


def _replace(store: Store, index: Index, made: Sequence[Shard], keys: Keys, etag: str | None) -> Index:
    """Make `index` the current one. Raises ConditionFailed where another came between; `made` is then taken away."""
    over = max(0, len(index.retired) - RETIRED)
    # Before the index forgets their names: no index, this or a rival's, ever lists a retired shard again.
    _delete(store, index.collection, index.retired[:over])
    index = Index(index.collection, index.version, index.updated, index.shards, index.retired[over:])
    try:
        put_mutable(store, index_name(index.collection), sealed(index, keys.signers), etag)
    except ConditionFailed:
        _take_back(store, index.version, index.collection, made)
        raise
    return index


def _take_back(store: Store, version: int, collection: str, made: Sequence[Shard]) -> None:
    """Delete what was made for a version that another has won, unless the winner lists the very same.

    A version is won only once, so from then on nobody begins to list them. An answer that was lost on the way looks
    like a lost race too; then the index lists ours.
    """
    winner = _present_or_none(read_mutable(store, index_name(collection))[0], collection)
    if winner is not None and winner.version >= version:
        known = {*(shard.sha256 for shard in winner.shards), *winner.retired}
        _delete(store, collection, [shard.sha256 for shard in made if shard.sha256 not in known])


def _delete(store: Store, collection: str, hashes: Sequence[str]) -> None:
    for sha256 in hashes:
        with suppress(OSError):  # a store that refuses to delete costs space, not a publication
            store.delete(shard_name(collection, sha256))
