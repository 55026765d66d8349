"""A collection's search index finds exactly what the filter accepts, whatever has been changed before."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture2vr.gateway.search import index_file, places, query, updates
from capture2vr.gateway.search.collection_index import CollectionIndex
from capture2vr.gateway.search.listing import CollectionListing, Search
from capture2vr.storage.catalogue.collection import Row
from capture2vr.storage.catalogue.row_filter import RowFilter
from tests.gateway.search.pieces import all_pages, expected, gone, listing_of, row_named

# What SQLite, its trigrams or `casefold` could get wrong: quotes, wildcards, NUL, a lone surrogate, and letters that
# become two without case.
TEXTS = st.text("abß\u0130ſS \"'*%_-\0\ud800\ufffd?\x01\U0001f600", max_size=7)
KEYS = st.from_regex(r"[abS][abS._-]{0,4}", fullmatch=True)
ROWS = st.builds(
    Row,
    key=KEYS,
    label=TEXTS,
    labels=st.lists(TEXTS, max_size=2).map(tuple),
    version=st.integers(1, 9),
    state=st.sampled_from(["preview", "refined", "removed", "unheard-of"]),
    updated=st.integers(0, 9),
    manifest=st.just("ab" * 32),
    preview=st.sampled_from(["", "cd" * 32]),
    bytes=st.integers(0, 9),
    grade=st.sampled_from(["", "good"]),
)
COLLECTIONS = st.lists(ROWS, max_size=14, unique_by=lambda row: row.key).map(
    lambda rows: sorted(rows, key=lambda row: row.key)
)
TIMES = st.none() | st.integers(0, 90).map(lambda tenths: datetime.fromtimestamp(tenths / 10, UTC))
SIZES = st.none() | st.integers(0, 9) | st.just(10**30)
FILTERS = st.builds(
    RowFilter, TEXTS, st.sampled_from(["", "", "", "preview", "refined", "removed"]), TIMES, TIMES, SIZES, SIZES
)


@st.composite
def cut(draw: st.DrawFn) -> list[list[Row]]:
    """A collection, cut into leaves."""
    rows, leaves = draw(COLLECTIONS), []
    while rows:
        size = draw(st.integers(1, 4))
        leaves.append(rows[:size])
        rows = rows[size:]
    return leaves


@st.composite
def filters(draw: st.DrawFn, leaves: list[list[Row]]) -> RowFilter:
    """A filter, often with a part of a label or tag that is there."""
    wanted = draw(FILTERS)
    texts = [text for rows in leaves for row in rows for text in (row.label or row.key, *row.labels)]
    if texts and draw(st.booleans()):
        text = draw(st.sampled_from(texts))
        start = draw(st.integers(0, len(text)))
        wanted = replace(wanted, label=text[start : draw(st.integers(start, len(text)))])
    return wanted


@pytest.fixture
def index(tmp_path: Path) -> CollectionIndex:
    return CollectionIndex(tmp_path / "search" / "index.db")


def make(index: CollectionIndex, listing: CollectionListing) -> None:
    index.make(lambda: listing, lambda: None)


@pytest.mark.slow
@pytest.mark.parametrize("trigrams", [True, False])
@given(st.data())
@settings(max_examples=60, deadline=None)
def test_it_finds_what_the_filter_accepts_after_any_changes(trigrams: bool, data: st.DataObject) -> None:
    with TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        if not trigrams:
            for module in (index_file, query):
                patch.setattr(module, "has_trigrams", lambda: False)
        patch.setattr(query, "_FEW_ROWS", data.draw(st.sampled_from([-1, 4, 100]), "few"))
        patch.setattr(query, "_MOST_TERMS", data.draw(st.sampled_from([0, 12]), "terms"))
        patch.setattr(query, "_MOST_GRAMS", data.draw(st.sampled_from([1, 16]), "grams"))
        index = CollectionIndex(Path(folder) / "index.db")
        for version in range(1, 4):
            leaves = data.draw(cut(), "leaves")
            listing = listing_of(leaves, version)
            if not (version > 1 and data.draw(st.booleans(), "by a request") and index.catch_up(lambda: listing)):  # noqa: B023
                make(index, listing)
            for _ in range(3):
                wanted = data.draw(filters(leaves), "filter")
                limit = data.draw(st.integers(1, 5), "limit")
                assert all_pages(index, listing.token, wanted, limit) == expected(leaves, wanted)
                after = data.draw(KEYS, "after")
                found = index.find(Search(wanted, after, limit), listing.token)
                assert found is not None
                assert found.rows == expected(leaves, wanted, after, limit)


def test_rows_come_as_they_are_listed(index: CollectionIndex) -> None:
    rows = [
        row_named("boot", "Walking Boot", "Leder", "footwear", updated=7, size=8),
        row_named("shoe", "Straßenschuh", "footwear", state="preview"),
        row_named("sofa"),
    ]
    listing = listing_of([rows[:2], rows[2:]], 5)
    make(index, listing)
    for label, keys in (
        ("strasse", "shoe"),
        ("LEDER", "boot"),
        ("footwear", "boot shoe"),
        ("foot", ""),
        ("o", "boot sofa"),
    ):
        found = index.find(Search(RowFilter(label), "", 100), listing.token)
        assert found is not None
        assert (found.version, found.rows) == (5, tuple(row for row in rows if row.key in keys.split()))


def growing() -> Iterator[list[list[Row]]]:
    """Leaves of at most four rows, of which the same one is always full, and splits: keys that grow in the middle."""
    leaves = [[row_named("a")], [row_named("m")], [row_named("z")]]
    for number in range(50):
        grown = [*leaves[-2], row_named(f"m{number:04d}", f"label {number}")]
        leaves = [*leaves[:-2], *([grown] if len(grown) <= 4 else [grown[:2], grown[2:]]), leaves[-1]]
        yield leaves


def test_where_there_is_no_room_neighbours_move(index: CollectionIndex, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every third change halves the room between the shard that grows and the one behind it."""
    monkeypatch.setattr(places, "_SPREAD", 3)
    make(index, listing_of([[row_named("a")], [row_named("z")]], 0))
    for version, leaves in enumerate(growing(), 1):
        listing = listing_of(leaves, version)
        assert index.catch_up(lambda: listing)  # noqa: B023
    assert all_pages(index, listing.token, RowFilter(), 50) == expected(leaves, RowFilter(), limit=1000)
    assert len(expected(leaves, RowFilter("label"), limit=1000)) == 50


def test_a_small_change_reads_only_what_is_new(index: CollectionIndex) -> None:
    leaves = [[row_named(f"{letter}1"), row_named(f"{letter}2")] for letter in "abcdefg"]
    make(index, listing_of(leaves))
    leaves[3] = [*leaves[3], row_named("d3", "new")]
    changed = listing_of(leaves, 2)
    read: list[str] = []
    assert index.catch_up(
        lambda: replace(changed, rows=lambda shard: [read.append(shard.first), *changed.rows(shard)][1:])
    )
    assert read == ["d1"]
    assert all_pages(index, changed.token, RowFilter("new"), 9) == (leaves[3][2],)
    assert index.find(Search(RowFilter("new"), "", 9), "version 1") is None, "it is not what was asked for"


def test_a_large_change_is_left_to_a_thread(index: CollectionIndex, monkeypatch: pytest.MonkeyPatch) -> None:
    make(index, listing_of([[row_named("a")]]))
    monkeypatch.setattr(updates, "_FEW_ROWS", 1)
    listing = listing_of([[row_named("a")], [row_named("b")], [row_named("c")]], 2)
    assert not index.catch_up(lambda: listing)
    make(index, listing)
    assert len(all_pages(index, listing.token, RowFilter(), 2)) == 3


def test_what_is_made_while_shards_are_replaced_begins_again_with_the_rest(
    index: CollectionIndex, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(updates, "_BATCH", 1)
    first = listing_of([[row_named("a")], [row_named("b")]], 1)
    second = listing_of([[row_named("a")], [row_named("b2")]], 2)
    versions = iter(
        [replace(first, rows=lambda shard: first.rows(shard) if shard.first == "a" else gone(shard)), second]
    )
    index.make(lambda: next(versions), lambda: None)
    assert [row.key for row in all_pages(index, second.token, RowFilter(), 9)] == ["a", "b2"]


def test_one_that_was_stopped_answers_nothing_and_goes_on(
    index: CollectionIndex, monkeypatch: pytest.MonkeyPatch
) -> None:
    class KilledError(Exception):
        pass

    def kill() -> None:
        raise KilledError

    monkeypatch.setattr(updates, "_BATCH", 1)
    listing = listing_of([[row_named("a")], [row_named("b")]])
    with pytest.raises(KilledError):
        index.make(lambda: listing, kill)
    assert index.find(Search(RowFilter("a"), "", 9), None) is None
    assert not index.catch_up(lambda: listing)
    make(index, replace(listing, rows=lambda shard: listing.rows(shard) if shard.first == "b" else gone(shard)))
    assert len(all_pages(index, listing.token, RowFilter(), 9)) == 2


def test_a_search_while_the_file_is_made_finds_none_and_spoils_nothing(
    index: CollectionIndex, monkeypatch: pytest.MonkeyPatch
) -> None:
    found, put_meta = [], index_file._put_meta

    def search_and_put(connection: sqlite3.Connection, **values: object) -> None:
        found.append(index.find(Search(RowFilter("label"), "", 9), None))
        put_meta(connection, **values)

    monkeypatch.setattr(index_file, "_put_meta", search_and_put)
    index.path.parent.mkdir()
    index.path.with_suffix(".new").write_bytes(b"left by a process that died")
    listing = listing_of([[row_named("a", "label")]])
    make(index, listing)
    assert set(found) == {None}
    assert (index.is_doomed, index.may_change) == (False, True)
    assert len(all_pages(index, listing.token, RowFilter("label"), 9)) == 1
    assert [path.name for path in index.path.parent.iterdir()] == ["index.db"]


@pytest.mark.parametrize("damage", ["no database", "half", "tables", "form"])
def test_a_damaged_file_is_made_anew(index: CollectionIndex, damage: str) -> None:
    listing = listing_of([[row_named(f"a{number}", "label")] for number in range(40)])
    make(index, listing)
    whole = index.path.read_bytes()
    match damage:
        case "no database":
            index.path.write_bytes(b"hello" * 1000)
        case "half":
            index.path.write_bytes(whole[: len(whole) // 2])
        case "tables":
            index.path.write_bytes(whole[:100] + bytes(len(whole) - 100))
        case "form":
            _execute(index.path, "UPDATE meta SET value = 'of a later release' WHERE name = 'form'")
    assert index.find(Search(RowFilter("label"), "", 9), listing.token) is None
    assert index.is_doomed
    index.remove()
    make(index, listing)
    assert len(all_pages(index, listing.token, RowFilter("label"), 9)) == 40


def _execute(path: Path, statement: str) -> None:
    with sqlite3.connect(path) as connection:
        connection.execute(statement)
    connection.close()


@pytest.mark.parametrize(
    "wrong", [{"bytes": 2**70}, {"manifest": "not hexadecimal"}, {"state": "\ud800"}, {"updated": []}]
)
def test_rows_that_no_publisher_writes_are_left_to_a_scan(index: CollectionIndex, wrong: dict[str, object]) -> None:
    listing = listing_of([[row_named("a")]])
    make(index, replace(listing, rows=lambda _: (replace(row_named("a"), **wrong),)))
    assert index.is_doomed
    index.remove()
    assert not index.may_change, "not tried again with every search"


def test_an_index_that_the_store_has_from_a_backup_takes_the_place_of_a_newer_one(index: CollectionIndex) -> None:
    make(index, listing_of([[row_named("a")], [row_named("b")]], 9))
    older = listing_of([[row_named("a")]], 8)
    assert index.catch_up(lambda: older)
    found = index.find(Search(RowFilter(), "", 9), None)
    assert found is not None
    assert (found.version, len(found.rows)) == (8, 1)
