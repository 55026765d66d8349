"""Bring a search index up to date with its collection: delete the rows of shards that are gone, insert new ones'."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import groupby, islice
from typing import TypeVar

from capture2vr.gateway.search.index_file import (
    Leaf,
    insert_leaf,
    leaf_before,
    leaf_behind,
    leaf_hashes,
    leaf_of_hash,
    prepare_to_write,
    read_meta,
    take_leaf,
    transaction,
    write_meta,
)
from capture2vr.gateway.search.listing import CollectionListing
from capture2vr.gateway.search.places import places_between
from capture2vr.storage.catalogue.collection import Row, Shard

_T = TypeVar("_T")

_FEW_ROWS = 10_000  # that a request inserts or deletes before it answers: a fraction of a second
_BATCH = 128  # shards of a transaction, between which other threads have their turn
# What SQLite says of values that it cannot hold, such as numbers of more than 64 bits, and of shards that overlap.
_UNFIT = (
    OverflowError,
    ValueError,
    TypeError,
    sqlite3.InterfaceError,
    sqlite3.ProgrammingError,
    sqlite3.IntegrityError,
)
_READERS = 8  # shards read at once: a store behind a network takes tens of milliseconds for each


class UnfitForIndex(Exception):  # noqa: N818 - it reads as what it is
    """The rows of this collection cannot be kept in an index."""


@dataclass(frozen=True, slots=True)
class Difference:
    """What an index lacks of its collection.

    gone  hashes of shards that the collection does not list any more
    new   shards that the index does not have, in the order of their keys
    """

    gone: Collection[str]
    new: Sequence[Shard]


@dataclass(frozen=True, slots=True)
class _ArrivedRows:
    """Rows of a shard on their way into the index."""

    sha256: str
    rows: Sequence[Row]


def difference(connection: sqlite3.Connection, listing: CollectionListing) -> Difference:
    """Compare the shards of an index with those of its collection. They never change: their hashes say it all."""
    if changed := listing.changed(read_meta(connection)[0]):
        gone, fresh = changed
        return Difference([shard.sha256 for shard in gone], fresh)
    stored = leaf_hashes(connection)
    current = {shard.sha256: shard for shard in listing.leaves("")}
    new = [shard for sha256, shard in current.items() if sha256 not in stored]
    return Difference(stored - current.keys(), new)


def is_small(connection: sqlite3.Connection, missing: Difference) -> bool:
    """Return whether a request can wait until what is missing is in the index."""
    if sum(shard.count for shard in missing.new) > _FEW_ROWS or len(missing.gone) > _FEW_ROWS:
        return False
    return sum(leaf_of_hash(connection, sha256).count for sha256 in missing.gone) <= _FEW_ROWS


def update(connection: sqlite3.Connection, listing: CollectionListing, missing: Difference) -> None:
    """Make a small change, all or nothing. Raises CatalogueFault, UnfitForIndex, sqlite3.Error, OSError."""
    arrived = list(_read(listing, missing.new))
    with transaction(connection):
        for sha256 in missing.gone:
            take_leaf(connection, leaf_of_hash(connection, sha256))
        _insert(connection, arrived)
        write_meta(connection, listing.token, listing.version)


def build(
    connection: sqlite3.Connection, listing: CollectionListing, missing: Difference, pause: Callable[[], None]
) -> None:
    """Make a large change, batch by batch; what is in the file stays there when it is cut short.

    pause  is called between batches; what it raises ends the build
    Raises CatalogueFault, UnfitForIndex, sqlite3.Error, OSError.
    """
    prepare_to_write(connection)
    with transaction(connection):
        write_meta(connection, "", 0)
    for gone in _batches(missing.gone):
        with transaction(connection):
            for sha256 in gone:
                take_leaf(connection, leaf_of_hash(connection, sha256))
        pause()
    for new in _batches(missing.new):
        arrived = list(_read(listing, new))
        with transaction(connection):
            _insert(connection, arrived)
        pause()
    with transaction(connection):
        write_meta(connection, listing.token, listing.version)


def has(connection: sqlite3.Connection, listing: CollectionListing) -> bool:
    """Return whether an index is that of the collection as it is. Raises sqlite3.DatabaseError where it is damaged."""
    return read_meta(connection)[0] == listing.token


def _read(listing: CollectionListing, shards: Sequence[Shard]) -> Iterator[_ArrivedRows]:
    with ThreadPoolExecutor(min(_READERS, len(shards) or 1)) as readers:
        for shard, rows in zip(shards, readers.map(listing.rows, shards), strict=True):
            kept = tuple(rows)
            if kept:
                yield _ArrivedRows(shard.sha256, kept)


def _insert(connection: sqlite3.Connection, arrived: Iterable[_ArrivedRows]) -> None:
    """Insert shards, which are in the order of their keys, between those that are there."""

    def neighbour(each: _ArrivedRows) -> int:
        before = leaf_before(connection, each.rows[0].key)
        return before.start if before else -1

    runs = [list(run) for _, run in groupby(arrived, key=neighbour)]
    for run in runs:
        _insert_run(connection, run)


def _insert_run(connection: sqlite3.Connection, run: list[_ArrivedRows]) -> None:
    """Insert shards between which there are no others; where there is no room, their neighbours move."""
    widen_by = 1
    while True:
        before = leaf_before(connection, run[0].rows[0].key)
        behind = leaf_behind(connection, run[-1].rows[0].key)
        low, high = before.end if before else 0, behind.start if behind else None
        starts = places_between([len(each.rows) for each in run], low, high)
        if starts is not None:
            break
        run = _widen(connection, run, widen_by)
        widen_by *= 2
    for start, each in zip(starts, run, strict=True):
        try:
            insert_leaf(connection, each.sha256, start, each.rows)
        except _UNFIT as error:
            raise UnfitForIndex(f"shard {each.sha256:.16}: {error}") from error


def _widen(connection: sqlite3.Connection, run: list[_ArrivedRows], by: int) -> list[_ArrivedRows]:
    """Take up to `by` shards on each side out of the index and into the run."""
    for _ in range(by):
        if before := leaf_before(connection, run[0].rows[0].key):
            run = [_taken(connection, before), *run]
        if behind := leaf_behind(connection, run[-1].rows[0].key):
            run = [*run, _taken(connection, behind)]
    return run


def _taken(connection: sqlite3.Connection, leaf: Leaf) -> _ArrivedRows:
    return _ArrivedRows(leaf.sha256, take_leaf(connection, leaf))


def _batches(items: Iterable[_T]) -> Iterator[list[_T]]:
    remaining = iter(items)
    while batch := list(islice(remaining, _BATCH)):
        yield batch
