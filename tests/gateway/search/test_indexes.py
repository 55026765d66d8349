"""Search indexes are made when they are needed, take no more room than they may, and change no answer."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from capture2vr.gateway.search import indexes as search_indexes
from capture2vr.gateway.search.indexes import SearchIndexes
from capture2vr.gateway.search.listing import CollectionListing, FoundRows, Search
from capture2vr.storage.catalogue.row_filter import RowFilter
from tests.gateway.search.pieces import expected, gone, listing_of, row_named
from tests.support.patience import PATIENCE_S

LEAVES = [[row_named(f"{letter}{number}", f"label {letter}") for number in range(9)] for letter in "abcdefgh"]
LISTING = listing_of(LEAVES)
INDEXED = replace(LISTING, rows=gone)
"""Who can search in it has an index."""
WANTED = RowFilter("label c")
SEARCH = Search(WANTED, "", 5)


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Collections of a few rows are large ones, and the disk of this machine is as full as it is."""
    monkeypatch.setattr(search_indexes, "SCANNED_ROWS", 10)
    monkeypatch.setattr(search_indexes, "_SPARE_BYTES", 0)


@pytest.fixture
def indexes(tmp_path: Path) -> Iterator[SearchIndexes]:
    with closing(SearchIndexes(tmp_path / "search", 1 << 30)) as indexes:
        yield indexes


def files(indexes: SearchIndexes) -> list[str]:
    return sorted(path.name for path in indexes._folder.glob("*.db"))


def search(
    indexes: SearchIndexes, listing: CollectionListing = LISTING, tenant: str = "ada", name: str = "default"
) -> FoundRows:
    return indexes.search(tenant, name, lambda: listing, SEARCH)


def wait_until(is_so: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE_S
    while not is_so():
        assert time.monotonic() < end
        time.sleep(0.01)


def index(indexes: SearchIndexes, tenant: str = "ada", name: str = "default") -> str:
    """Have a collection indexed; the name of the file."""
    before = files(indexes)
    search(indexes, tenant=tenant, name=name)
    wait_until(lambda: not any(each.building for each in indexes._indexes.values()))
    (made,) = set(files(indexes)) - set(before)
    return made


def test_the_answer_is_the_same_before_and_after_the_index_is_made(indexes: SearchIndexes) -> None:
    first = search(indexes)
    assert (first.rows, first.next) == (expected(LEAVES, WANTED, limit=5), "c4")
    wait_until(lambda: files(indexes) != [] and not any(each.building for each in indexes._indexes.values()))
    assert search(indexes, INDEXED) == first
    rest = indexes.search("ada", "default", lambda: INDEXED, Search(WANTED, "c4", 5))
    assert (rest.rows, rest.next) == (expected(LEAVES, WANTED, "c4"), None)


def test_a_change_is_found_by_the_next_search(indexes: SearchIndexes) -> None:
    index(indexes)
    leaves = [*LEAVES, [row_named("x", "A new LABEL C")]]
    changed = listing_of(leaves, 2)
    only_new = replace(changed, rows=lambda shard: changed.rows(shard) if shard.first == "x" else gone(shard))
    found = indexes.search("ada", "default", lambda: only_new, Search(WANTED, "c8", 5))
    assert (found.version, [row.key for row in found.rows]) == (2, ["x"])


def test_small_collections_and_lists_of_everything_need_none(indexes: SearchIndexes) -> None:
    search(indexes, listing_of(LEAVES[:1]))
    assert indexes.search("ada", "default", lambda: LISTING, Search(RowFilter(), "", 5)).rows == tuple(LEAVES[0][:5])
    assert files(indexes) == []


def test_none_are_made_where_they_may_have_no_bytes(tmp_path: Path) -> None:
    with closing(SearchIndexes(tmp_path / "search", 0)) as indexes:
        assert search(indexes).rows == expected(LEAVES, WANTED, limit=5)
        assert files(indexes) == []


def test_tenants_and_collections_have_their_own_and_a_deleted_tenant_has_none(indexes: SearchIndexes) -> None:
    of_ada, of_bob = [index(indexes, "ada"), index(indexes, "ada", "other")], index(indexes, "bob")
    assert len({*of_ada, of_bob}) == 3
    indexes.forget("ada")
    assert files(indexes) == [of_bob]


def test_the_least_recently_used_goes_where_there_are_too_many(
    indexes: SearchIndexes, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = index(indexes, name="one"), index(indexes, name="two")
    os.utime(indexes._folder / first, (time.time() - 9,) * 2)
    os.utime(indexes._folder / second, (time.time() - 99,) * 2)
    monkeypatch.setattr(search_indexes, "_MOST_FILES", 2)
    third = index(indexes, name="three")
    wait_until(lambda: files(indexes) == sorted([first, third]))  # who built it sweeps after it has said so
    indexes._most_bytes = indexes._indexes[third].size
    indexes.sweep()
    assert files(indexes) == [third]


def test_one_that_nobody_has_used_for_a_day_goes(indexes: SearchIndexes) -> None:
    made, other = index(indexes), index(indexes, name="other")
    os.utime(indexes._folder / made, (time.time() - 86_401,) * 2)
    indexes.sweep()
    assert files(indexes) == [other]


def test_one_that_takes_more_room_than_it_may_is_not_tried_again_and_again(tmp_path: Path) -> None:
    with closing(SearchIndexes(tmp_path / "search", 1000)) as indexes:
        for _ in range(2):
            assert search(indexes).rows == expected(LEAVES, WANTED, limit=5)
            wait_until(lambda: not any(each.building for each in indexes._indexes.values()))
        assert files(indexes) == []
        assert not any(each.may_change for each in indexes._indexes.values())


def test_a_full_disk_gets_none(indexes: SearchIndexes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search_indexes, "_SPARE_BYTES", 1 << 80)
    assert search(indexes).rows == expected(LEAVES, WANTED, limit=5)
    wait_until(lambda: not any(each.building for each in indexes._indexes.values()))
    assert files(indexes) == []


def test_a_damaged_file_changes_no_answer_and_is_replaced(indexes: SearchIndexes) -> None:
    path = indexes._folder / index(indexes)
    for suffix in ("-wal", "-shm"):
        path.with_name(path.name + suffix).unlink(missing_ok=True)
    path.write_bytes(b"damaged" * 1000)
    assert search(indexes).rows == expected(LEAVES, WANTED, limit=5)
    assert files(indexes) == []
    index(indexes)
    assert search(indexes, INDEXED).rows == expected(LEAVES, WANTED, limit=5)


def test_a_gateway_goes_on_with_the_indexes_of_its_last_start(tmp_path: Path) -> None:
    with closing(SearchIndexes(tmp_path / "search", 1 << 30)) as indexes:
        made = index(indexes)
    with closing(SearchIndexes(tmp_path / "search", 1 << 30)) as again:
        assert search(again, INDEXED).rows == expected(LEAVES, WANTED, limit=5)
        indexes.forget("ada")
        assert files(again) == [], made
