"""Finding one row among many shards, and readers that are overtaken."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.storage.catalogue.collection import Row, Shard, describe_shard
from capture2vr.storage.catalogue.faults import SHARD_CHANGED, SHARD_MISSING, CatalogueFault
from capture2vr.storage.catalogue.reader import TreeParts, collection_names, find_row, retry_if_shard_missing
from capture2vr.storage.catalogue.root import Index
from capture2vr.storage.store import Store

KEYS = st.from_regex(r"[A-Za-z0-9][A-Za-z0-9._-]{0,8}", fullmatch=True)


def test_the_collections_of_a_store(store: Store) -> None:
    assert list(collection_names(store)) == []
    names = ["ada", "ada-b", "ada.c", "ada0", "adab", "Zoe", "0", "x" * 100]
    for name in names:
        for file in ("index.json", "shard.1.json", "unity/catalog.json"):
            store.put(f"collections/{name}/{file}", b"1", content_type="application/json")
    store.put("collectionsx/none/index.json", b"1", content_type="application/json")
    assert sorted(collection_names(store)) == sorted(names)


def row(key: str) -> Row:
    return Row(key, "", (), 1, "refined", 1, "0" * 64, "")


@pytest.mark.slow
@given(st.sets(KEYS, max_size=30), st.lists(KEYS, max_size=5), st.integers(1, 7))
def test_a_row_is_found_wherever_the_shards_were_split(keys: set[str], others: list[str], size: int) -> None:
    rows = [row(key) for key in sorted(keys)]
    parts = [rows[start : start + size] for start in range(0, len(rows), size)]
    shards = {describe_shard("c", part, str(place).encode()): part for place, part in enumerate(parts)}
    index, asked = Index("c", 1, "now", tuple(shards)), []

    def rows_of(shard: Shard) -> list[Row]:
        asked.append(shard)
        return shards[shard]

    for key in (*keys, *others):
        asked.clear()
        found = find_row(index, key, TreeParts(rows_of, lambda _, node: pytest.fail(f"there is no node {node}")))
        assert (found is not None) == (key in keys)
        assert len(asked) <= 1, "a client loads one shard, not all"
        if found:
            assert (found[0], found[1].key) == (asked[0], key)


@pytest.mark.parametrize(("code", "tries"), [(SHARD_MISSING, 3), (SHARD_CHANGED, 1)])
def test_only_what_moved_is_read_again_and_not_for_ever(code: str, tries: int) -> None:
    count = 0

    def attempt() -> None:
        nonlocal count
        count += 1
        raise CatalogueFault(code, "shard", "gone")

    with pytest.raises(CatalogueFault, match="gone"):
        retry_if_shard_missing(attempt)
    assert count == tries


def test_the_second_look_counts() -> None:
    answers = iter([CatalogueFault(SHARD_MISSING, "shard", "gone"), "found"])

    def attempt() -> str:
        if isinstance(answer := next(answers), CatalogueFault):
            raise answer
        return answer

    assert retry_if_shard_missing(attempt) == "found"
