"""Search in a large collection by its index: seconds to make it, bytes, milliseconds of a search and of an update.

The rows are made in memory and no store is read: what is measured is the index alone, and beside it the same search
over all rows without one.
"""

from __future__ import annotations

import argparse
import random
import sqlite3
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TypeVar

from capture2vr.gateway.search.collection_index import CollectionIndex
from capture2vr.gateway.search.listing import CollectionListing, Search
from capture2vr.storage.bundle import sha256_hex
from capture2vr.storage.catalogue.collection import Row, Shard
from capture2vr.storage.catalogue.row_filter import RowFilter

_T = TypeVar("_T")

LEAF_ROWS = 36
LIMIT = 20
START = 1_700_000_000  # seconds since 1970 of the first change; one a second
WORDS = ("boot", "shoe", "sofa", "chair", "lamp", "table", "vase", "statue", "dress", "truck", "bust", "helmet")
WORDS += ("walking", "old", "red", "blue", "green", "oak", "marble", "bronze", "north", "hall", "museum", "Straße")


class GeneratedCollection:
    """A collection of rows that are made when they are read."""

    def __init__(self, count: int) -> None:
        self.rows = count
        self.changes: dict[int, int] = {}  # of a leaf: how often it was replaced
        self.version = 1

    def listing(self) -> CollectionListing:
        """The collection as it is now."""
        shards = [self._shard(number) for number in range(-(-self.rows // LEAF_ROWS))]
        numbers = {shard.sha256: number for number, shard in enumerate(shards)}
        return CollectionListing(
            version=self.version,
            token=str(self.version),
            count=self.rows,
            leaves=lambda after: (shard for shard in shards if shard.last > after),
            rows=lambda shard: self.rows_of(numbers[shard.sha256]),
        )

    def change(self, leaf: int) -> None:
        """Give a row of a leaf a new version."""
        self.version += 1
        self.changes[leaf] = self.changes.get(leaf, 0) + 1

    def rows_of(self, leaf: int) -> tuple[Row, ...]:
        """Rows of a leaf: labels of three words and a number, one of 200 tags, half of the versions from a preview."""
        chance, first = random.Random(leaf), leaf * LEAF_ROWS
        changes = self.changes.get(leaf, 0)
        rows = [self._row(number, chance) for number in range(first, min(self.rows, first + LEAF_ROWS))]
        if changes:
            rows[0] = replace(rows[0], version=1 + changes, updated=START + self.rows + changes)
        return tuple(rows)

    def _row(self, number: int, chance: random.Random) -> Row:
        label = " ".join([*chance.choices(WORDS, k=3), str(chance.randrange(100_000))])
        return Row(
            key=_key(number),
            label=label.capitalize(),
            labels=(f"Tag {chance.randrange(200)}",),
            version=1,
            state="refined" if number % 2 else "preview",
            updated=START + number,
            manifest=chance.randbytes(32).hex(),
            preview=chance.randbytes(32).hex(),
            bytes=chance.randrange(1, 100_000_000),
            grade="good",
        )

    def _shard(self, leaf: int) -> Shard:
        first, end = leaf * LEAF_ROWS, min(self.rows, leaf * LEAF_ROWS + LEAF_ROWS)
        sha256 = sha256_hex(f"{leaf} {self.changes.get(leaf, 0)}".encode())
        return Shard(f"shard.{sha256}.json", sha256, 4_000, end - first, _key(first), _key(end - 1))


def _key(number: int) -> str:
    return f"asset-{number:07d}"


def searches(count: int) -> dict[str, Search]:
    """What people look for, easy and hard."""
    deep = _key(count * 9 // 10)

    def at(second: int) -> datetime:
        return datetime.fromtimestamp(START + second, UTC)

    return {
        "rare label": Search(RowFilter("marble bronze north 12"), "", LIMIT),
        "frequent label": Search(RowFilter("BRONZE"), "", LIMIT),
        "frequent label, deep page": Search(RowFilter("bronze"), deep, LIMIT),
        "frequent parts that are never together": Search(RowFilter("shoe boot shoe boot"), "", LIMIT),
        "a whole tag": Search(RowFilter("tag 77"), "", LIMIT),
        "a whole tag, deep page": Search(RowFilter("tag 77"), deep, LIMIT),
        "no such label": Search(RowFilter("zzzqq"), "", LIMIT),
        "one letter, frequent": Search(RowFilter("e"), "", LIMIT),
        "two letters, none": Search(RowFilter("zq"), "", LIMIT),
        "two letters, rare": Search(RowFilter("ß"), "", LIMIT),
        "changed in one minute": Search(RowFilter(since=at(count // 2), until=at(count // 2 + 60)), "", LIMIT),
        "changed never": Search(RowFilter(since=at(10 * count)), "", LIMIT),
        "largest thousandth": Search(RowFilter(min_bytes=99_900_000), "", LIMIT),
        "state no asset has": Search(RowFilter(state="removed"), "", LIMIT),
        "label, state, date and size": Search(
            RowFilter("vase", "refined", at(count // 4), at(count * 3 // 4), 1_000_000, 50_000_000), "", LIMIT
        ),
        "label and a size that few have": Search(RowFilter("vase", min_bytes=99_990_000), "", LIMIT),
    }


def main(arguments: list[str]) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench search-index", description=__doc__)
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--times", type=int, default=9, help="of each search; the median is shown")
    chosen = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        measure(GeneratedCollection(chosen.rows), CollectionIndex(Path(folder) / "index.db"), chosen.times)


def measure(collection: GeneratedCollection, index: CollectionIndex, times: int) -> None:
    """Make the index, search in it, and change it."""
    listing = collection.listing()
    everything, read_s = _timed(lambda: [row for shard in listing.leaves("") for row in listing.rows(shard)])
    wall_s, cpu_s = _clocks(lambda: index.make(lambda: listing, lambda: None))
    print(f"{collection.rows:,} rows in {len(list(listing.leaves(''))):,} shards, SQLite {sqlite3.sqlite_version}\n")
    print(
        f"made in {wall_s - read_s[0]:.0f} s ({cpu_s - read_s[1]:.0f} s of CPU) besides making the rows; "
        f"{index.size / 1e6:.0f} MB\n"
    )
    print("| search | found | by the index | without it |\n| --- | ---: | ---: | ---: |")
    for name, search in searches(collection.rows).items():
        _print_search(name, search, index, listing.token, everything, times)
    _print_updates(collection, index, times)


def _print_search(
    name: str, search: Search, index: CollectionIndex, token: str, rows: Sequence[Row], times: int
) -> None:
    measured = [_clocks(lambda: index.find(search, token)) for _ in range(times)]
    found = index.find(search, token)
    behind = (row for row in rows if row.key > search.after and search.wanted.accepts(row))
    expected, (without_s, _) = _timed(lambda: tuple(islice(behind, search.limit)))
    assert found is not None
    assert found.rows == expected, name
    print(f"| {name} | {len(expected)} | {_ms(measured)} | {without_s * 1e3:,.0f} ms |")


def _print_updates(collection: GeneratedCollection, index: CollectionIndex, times: int) -> None:
    measured, changed = [], RowFilter(since=datetime.fromtimestamp(START + collection.rows, UTC))
    for number in range(times):
        collection.change(number * 97 % (collection.rows // LEAF_ROWS))
        listing = collection.listing()
        measured.append(_clocks(partial(index.catch_up, partial(replace, listing))))
        found = index.find(Search(changed, "", 100), listing.token)
        assert found is not None
        assert len(found.rows) == number + 1
    print(f"\none row changed, all shards compared: {_ms(measured)}")


def _timed(work: Callable[[], _T]) -> tuple[_T, tuple[float, float]]:
    """Call it; seconds on the wall, and of CPU."""
    cpu, wall = time.process_time(), time.perf_counter()
    result = work()
    return result, (time.perf_counter() - wall, time.process_time() - cpu)


def _clocks(work: Callable[[], object]) -> tuple[float, float]:
    return _timed(work)[1]


def _ms(measured: Sequence[tuple[float, float]]) -> str:
    wall, cpu = (statistics.median(each) * 1e3 for each in zip(*measured, strict=True))
    return f"{wall:.1f} ms ({cpu:.1f} ms of CPU)"
