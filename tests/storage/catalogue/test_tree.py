"""The tree of a collection: what was put in is found, in order, whatever came before, at the cost of one path."""

from __future__ import annotations

import json
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from functools import partial

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture2vr.storage.catalogue import tree
from capture2vr.storage.catalogue.collection import Row, Shard, describe_shard, shard_data
from capture2vr.storage.catalogue.commit import commit, rows_of_index
from capture2vr.storage.catalogue.faults import CATALOGUE_TRUNCATED, SHARD_CHANGED, SHARD_MISSING, CatalogueFault
from capture2vr.storage.catalogue.reader import find_row, parts_on, read_root
from capture2vr.storage.catalogue.retired import all_objects
from capture2vr.storage.catalogue.root import Index, index_name, root_name, seal, sign_index
from capture2vr.storage.catalogue.signing import NO_KEYS, Keys
from capture2vr.storage.catalogue.tree import Draft, changed_shards, shards_of
from capture2vr.storage.memory import MemoryStore
from capture2vr.storage.store import list_all
from tests.storage.catalogue.test_signing import ONE
from tests.support.patience import PATIENCE_S

KEYS = [f"k{number:03d}" for number in range(120)]
CHANGES = st.dictionaries(st.sampled_from(KEYS), st.sampled_from([0, 1, 2]), max_size=30)
"""What becomes of keys: 0 removes one, the others are versions."""


def row(key: str, version: int = 1) -> Row:
    return Row(key, f"Label of {key}", ("chair",), version, "refined", 1, "0a" * 32, "", 5, "good")


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(st.lists(CHANGES, min_size=1, max_size=12))
def test_a_tree_has_what_was_put_into_it_and_nothing_else(changes: list[dict[str, int]]) -> None:
    """With at most three rows a shard and three parts a node, so that it becomes deep."""
    store, model = MemoryStore(), dict[str, Row]()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tree, "LEAF_ROWS", 3)
        patch.setattr(tree, "NODE_PARTS", 3)
        before: Index | None = None
        for change in changes:
            rows = {key: row(key, version) if version else None for key, version in change.items()}
            commit(store, "c", lambda _, rows=rows: rows, NO_KEYS)  # type: ignore[misc]
            for key, found in rows.items():
                if found is None:
                    model.pop(key, None)
                else:
                    model[key] = found
            if not list_all_names(store):
                continue
            index, parts = read_root(store, "c"), parts_on(store, "c")
            assert rows_of_index(store, index) == [model[key] for key in sorted(model)]
            assert index.count == len(model)
            if before is not None and None not in rows.values():  # after a removal, its nodes are gone
                gone, new = changed_shards(before, index, parts.nodes)
                old, now = ({shard.name for shard in shards_of(each, parts.nodes)} for each in (before, index))
                assert ({shard.name for shard in gone}, {shard.name for shard in new}) == (old - now, now - old)
            before = index
            assert len(index.parts) <= 3
            assert all(each.count <= 3 for each in shards_of(index, parts.nodes))
            for key in KEYS[::7]:
                found_row = find_row(index, key, parts)
                assert (found_row[1] if found_row else None) == model.get(key)
            behind = [each for shard in shards_of(index, parts.nodes, "k060") for each in parts.rows(shard)]
            assert [each.key for each in behind if each.key > "k060"] == [key for key in sorted(model) if key > "k060"]
            reachable = {*all_objects(store, index), root_name("c")}
            assert list_all_names(store) == reachable, "nothing is left that no later change deletes"


def list_all_names(store: MemoryStore) -> set[str]:
    return {head.name for head in list_all(store, "collections/")}


def built(store: MemoryStore, count: int, keys: Keys = NO_KEYS) -> Index:
    """A collection of many assets that have rows and nothing else."""
    draft = Draft(store, "c", "first")
    parts, depth = draft.build([row(f"a{number:07d}") for number in range(count)])
    for name, data in draft.written.items():
        store.put(name, data, content_type="application/json")
    index = Index("c", 1, "2026-01-01T00:00:00Z", parts, depth, "first")
    store.put(root_name("c"), sign_index(index, keys.signers), content_type="application/json")
    return index


class Counted(MemoryStore):
    """A store that counts the bytes that are written."""

    written = 0

    def put(self, name: str, data: object, **how: object) -> object:  # type: ignore[override]
        self.written += len(data)  # type: ignore[arg-type]
        return super().put(name, data, **how)  # type: ignore[arg-type]


def test_what_changed_is_read_a_level_at_once() -> None:
    """The nodes of two changes far apart, old and new, are asked for together: each takes a store tens of ms."""
    store = MemoryStore()
    before = built(store, 3_000)
    assert before.depth == 1
    commit(store, "c", lambda _: {key: row(key, 2) for key in ("a0000001", "a0002999")}, NO_KEYS)
    together = threading.Barrier(4, timeout=PATIENCE_S)
    load = parts_on(store, "c").nodes

    def met(depth: int, node: Shard) -> tuple[Shard, ...]:
        together.wait()
        return load(depth, node)

    gone, fresh = changed_shards(before, read_root(store, "c"), met)
    assert [len(gone), len(fresh)] == [2, 2]


@pytest.mark.slow
def test_one_change_writes_one_path() -> None:
    """Some 4 kB at a hundred assets, and at most 13 kB at a hundred thousand: each level of nodes adds 3 kB."""
    cost = {}
    for count in (100, 100_000):
        store = Counted()
        built(store, count)
        before = store.written
        commit(store, "c", lambda _: {"a0000050x": row("a0000050x")}, NO_KEYS)
        cost[count] = store.written - before
    assert cost[100] < 6_000
    assert cost[100_000] < 13_000


def test_rivals_make_one_tree() -> None:
    store = MemoryStore()

    def put(number: int) -> None:
        commit(store, "c", lambda _: {f"k{number:03d}": row(f"k{number:03d}")}, NO_KEYS)

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(put, range(60)))
    index = read_root(store, "c")
    assert [each.key for each in rows_of_index(store, index)] == KEYS[:60]
    assert {*all_objects(store, index), root_name("c")} == list_all_names(store)


@pytest.mark.parametrize("put", [None, b"{}"])
def test_a_node_that_is_missing_or_another_is_named(put: bytes | None) -> None:
    store = MemoryStore()
    index = built(store, 2000)
    assert index.depth == 1
    for node in index.parts:
        if put is None:
            store.delete(node.name)
        else:
            store.put(node.name, put, content_type="application/json")
    for use in (
        partial(find_row, index, "a0000000", parts_on(store, "c")),
        partial(commit, store, "c", lambda _: {"a0000000": None}, NO_KEYS),
    ):
        with pytest.raises(CatalogueFault) as caught:
            use()
        assert caught.value.code == (SHARD_MISSING if put is None else SHARD_CHANGED)
        assert "/node." in caught.value.name


@pytest.mark.parametrize(
    "wrong",
    [
        {"depth": 9},
        {"depth": -1},
        {"depth": "x"},
        {"children": [["", 1, 1, "a", "b"]]},
        {"children": [["x" * 43, 1, 1, "a"]]},
        {"children": 5},
        {"columns": ["sha256"]},
        {"retired": 5},
        {"lists": [5]},
    ],
)
def test_a_root_that_is_none_is_named(wrong: dict[str, object]) -> None:
    store = MemoryStore()
    built(store, 10)
    document = {**json.loads(json.loads(store.get(root_name("c")))["signed"]), **wrong}
    store.put(root_name("c"), seal(document, ()), content_type="application/json")
    with pytest.raises(CatalogueFault) as caught:
        read_root(store, "c")
    assert caught.value.code == CATALOGUE_TRUNCATED


def flat(store: MemoryStore, rows: list[Row], version: int, keys: Keys) -> None:
    """Write a collection as releases before trees did: a flat index of shards of up to a thousand rows."""
    shards = []
    for first in range(0, len(rows), 1000):
        data = shard_data(rows[first : first + 1000], f"{version}")
        shards.append(describe_shard("c", rows[first : first + 1000], data))
        store.put(shards[-1].name, data, content_type="application/json")
    document = {
        "schema": 1,
        "collection": "c",
        "version": version,
        "updated": "2026-01-01T00:00:00Z",
        "shards": [asdict(shard) for shard in shards],
        "retired": [],
        "visibility": None,
    }
    store.put(index_name("c"), seal(document, keys.signers), content_type="application/json")


def test_a_collection_of_an_earlier_release_becomes_a_tree() -> None:
    store, keys = MemoryStore(), Keys(signers=(ONE,))
    flat(store, [row(f"a{number:05d}") for number in range(2500)], 41, keys)
    assert find_row(read_root(store, "c", keys.verification_keys), "a00007", parts_on(store, "c")) is not None
    index = commit(store, "c", lambda _: {"a00007": row("a00007", 2)}, keys)
    assert (index.version, index.count) == (42, 2500)
    found = rows_of_index(store, read_root(store, "c", keys.verification_keys))
    assert [(each.key, each.version) for each in found] == [
        (f"a{number:05d}", 2 if number == 7 else 1) for number in range(2500)
    ]
