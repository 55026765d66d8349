"""The forms for earlier clients: kept while a collection is small, seldom written while it is larger, then ended."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import pytest

from capture2vr.storage.catalogue import earlier_forms
from capture2vr.storage.catalogue.collection import Row, describe_shard, load_shard, shard_data
from capture2vr.storage.catalogue.earlier_forms import flat_index, take_over_flat, write_waiting_forms
from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.catalogue.publish import PublishPolicy, publish
from capture2vr.storage.catalogue.reader import read_root
from capture2vr.storage.catalogue.root import index_name, read_index, root_name, seal
from capture2vr.storage.catalogue.signing import NO_KEYS, Keys
from capture2vr.storage.catalogue.update import remove_row, update_collections
from capture2vr.storage.local import LocalStore
from capture2vr.storage.memory import MemoryStore
from capture2vr.storage.unity.json_reader import read_json_catalogue
from capture2vr.storage.unity.locations import parse_assets
from capture2vr.storage.unity.publication import catalogue_names
from tests.storage.catalogue.test_signing import ONE
from tests.support.bundles import Crash, CrashingStore, bundle, listed
from tests.support.repository import ROOT

SIGNED = Keys(signers=(ONE,))
SIGNING = PublishPolicy(SIGNED)
INDEX = index_name("default")


@pytest.fixture
def store() -> MemoryStore:
    return MemoryStore()


@pytest.fixture(autouse=True)
def nothing_waits() -> Iterator[None]:
    write_waiting_forms()
    yield
    write_waiting_forms()


def seen_by_an_earlier_client(store: MemoryStore) -> dict[str, int]:
    """Versions by key as the release before read them: `shards` of the flat index, each by its hash."""
    envelope = json.loads(store.get(INDEX))
    document = json.loads(envelope["signed"])
    assert document["schema"] == 1
    assert read_index(store.get(INDEX), "default", SIGNED.verification_keys)
    rows: dict[str, int] = {}
    for record in document["shards"]:
        shard = json.loads(store.get(f"collections/default/shard.{record['sha256']}.json"))
        assert record["count"] == len(shard["rows"])
        place = shard["columns"].index("version")
        rows |= {row[0]: row[place] for row in shard["rows"]}
    return rows


def seen_by_unity(store: MemoryStore) -> dict[str, int]:
    table = read_json_catalogue(store.get(catalogue_names("default")[0].catalogue))
    return {asset.key: asset.version for asset in parse_assets(table)}


def test_an_earlier_client_and_unity_see_a_small_collection_at_once(store: MemoryStore) -> None:
    for key, content in (("a", "1"), ("b", "1"), ("a", "2")):
        publish(bundle(content=content), store, key=key, policy=SIGNING)
        versions = {key: row.version for key, row in listed(store).items()}
        assert seen_by_an_earlier_client(store) == seen_by_unity(store) == versions
    flat = read_index(store.get(INDEX), "default")
    assert (flat.version, flat.commit) == (3, read_root(store, "default").commit)


def test_a_larger_one_seldom_and_the_last_change_is_not_forgotten(
    store: MemoryStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(earlier_forms, "_AT_ONCE_ROWS", 1)
    for key in "abcd":
        publish(bundle(), store, key=key, policy=SIGNING)
    assert sorted(listed(store)) == ["a", "b", "c", "d"]
    assert sorted(seen_by_an_earlier_client(store)) == ["a"], "half a minute has not passed"
    write_waiting_forms()  # as when the process ends
    assert sorted(seen_by_an_earlier_client(store)) == sorted(seen_by_unity(store)) == ["a", "b", "c", "d"]


_PUBLISHER = """
import sys
from pathlib import Path
from capture2vr.storage.catalogue import earlier_forms
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.local import LocalStore
from tests.support.repository import ROOT
from tests.support.bundles import bundle
earlier_forms._AT_ONCE_ROWS = 0
for key in "abc":
    publish(bundle(content=key), LocalStore(Path(sys.argv[1])), key=key)
"""


@pytest.mark.slow
def test_a_process_that_ends_writes_them(tmp_path: Path) -> None:
    subprocess.run(
        [sys.executable, "-c", _PUBLISHER, tmp_path], check=True, env={**os.environ, "PYTHONPATH": str(ROOT)}
    )
    flat = read_index(LocalStore(tmp_path).get(INDEX), "default")
    assert (flat.version, flat.count) == (3, 3)


def test_who_asks_a_gateway_for_the_flat_index_has_it_as_new_as_the_root(
    store: MemoryStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(earlier_forms, "_AT_ONCE_ROWS", 0)
    for key in "ab":
        publish(bundle(), store, key=key, policy=SIGNING)
    monkeypatch.setattr(earlier_forms, "_waiting", {})  # the process that would have written it was killed
    index = read_root(store, "default")
    assert read_index(flat_index(store, "default", NO_KEYS, index), "default").version == 1, "it cannot sign"
    assert read_index(flat_index(store, "default", SIGNED, index), "default").version == 2
    assert sorted(seen_by_an_earlier_client(store)) == ["a", "b"]


def test_a_large_one_has_none_until_it_is_small_again(store: MemoryStore, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(earlier_forms, "MOST_FLAT", 2)
    for key in "abc":
        publish(bundle(), store, key=key, policy=SIGNING)
    document = json.loads(json.loads(store.get(INDEX))["signed"])
    assert (document["see"], "shards" in document) == (root_name("default"), False)
    assert not store.list("collections/default/unity/")
    written = store.head(INDEX).etag
    publish(bundle(), store, key="d", policy=SIGNING)
    assert store.head(INDEX).etag == written, "once"
    for key in "cd":
        remove_row(store, "default", key, SIGNED)
    assert sorted(seen_by_an_earlier_client(store)) == sorted(seen_by_unity(store)) == ["a", "b"]


def test_what_a_worker_of_an_earlier_release_lists_is_taken_over(store: MemoryStore) -> None:
    """It runs beside this one during an upgrade, writes the flat index, and knows of no root."""
    publish(bundle(), store, key="a", policy=SIGNING)
    with pytest.raises(Crash):
        publish(bundle(), CrashingStore(store, 8, after=False), key="theirs", policy=SIGNING)  # not listed
    flat = read_index(store.get(INDEX), "default")
    theirs = read_entry(store, "theirs").document
    row = Row("theirs", "", (), 1, "preview", 5, theirs["manifest"]["sha256"], theirs["preview"]["sha256"])
    rows = sorted([*load_shard(store, flat.parts[0]), row], key=lambda each: each.key)
    data = shard_data(rows, "theirs")
    shard = describe_shard("default", rows, data)
    store.put(shard.name, data, content_type="application/json")
    document = {
        "schema": 1,
        "collection": "default",
        "version": 2,
        "updated": "",
        "shards": [asdict(shard)],
        "retired": [],
        "visibility": None,
    }
    store.put(INDEX, seal(document, SIGNED.signers), content_type="application/json")
    take_over_flat(store, "default", SIGNED)  # as a gateway does at each look
    assert sorted(listed(store, believed=SIGNED.verification_keys)) == ["a", "theirs"]
    store.put(INDEX, seal(document, SIGNED.signers), content_type="application/json")
    publish(bundle(), store, key="b", policy=SIGNING)
    assert sorted(listed(store, believed=SIGNED.verification_keys)) == ["a", "b", "theirs"]
    assert read_root(store, "default").version == 4, "no client has seen a higher one"
    assert sorted(seen_by_an_earlier_client(store)) == ["a", "b", "theirs"]


def test_a_forged_flat_index_is_no_source(store: MemoryStore) -> None:
    publish(bundle(), store, key="a", policy=SIGNING)
    document = {
        "schema": 1,
        "collection": "default",
        "version": 9,
        "updated": "",
        "shards": [],
        "retired": [],
        "visibility": None,
    }
    store.put(INDEX, seal(document, ()), content_type="application/json")
    update_collections(store, "a", SIGNED)
    publish(bundle(), store, key="b", policy=SIGNING)
    assert sorted(listed(store, believed=SIGNED.verification_keys)) == ["a", "b"]
    assert sorted(seen_by_an_earlier_client(store)) == ["a", "b"]
