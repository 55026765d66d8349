"""Unity's catalogues follow what is published, removed and restored, whoever publishes at the same time."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest

from capture2vr.storage.catalogue.change_entry import remove, restore
from capture2vr.storage.catalogue.entry import entry_name, read_entry
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.catalogue.update import update_collections
from capture2vr.storage.memory import MemoryStore
from capture2vr.storage.store import NO_CACHE
from capture2vr.storage.unity.json_reader import read_json_catalogue
from capture2vr.storage.unity.json_writer import json_catalogue
from capture2vr.storage.unity.locations import parse_assets
from capture2vr.storage.unity.nouns import Asset
from capture2vr.storage.unity.publication import catalogue_hash, catalogue_names
from tests.support.bundles import bundle
from tests.support.clients.unity_binary_reader import read_binary_catalogue


@pytest.fixture
def store() -> MemoryStore:
    return MemoryStore()


def listed(store: MemoryStore, collection: str = "default") -> dict[str, Asset]:
    """The assets of all four catalogues, which must agree, and whose hashes must be those of their content."""
    seen = []
    for names in catalogue_names(collection):
        data = store.get(names.catalogue)
        assert store.get(names.hash) == catalogue_hash(data)
        assert {store.head(name).cache_control for name in (names.catalogue, names.hash)} == {NO_CACHE}
        read = read_binary_catalogue if names.form else read_json_catalogue
        seen.append({asset.key: asset for asset in parse_assets(read(data))})
    assert all(each == seen[0] for each in seen)
    return seen[0]


def test_what_is_published_is_listed_with_its_files(store: MemoryStore) -> None:
    publish(bundle("preview"), store, key="dress")
    publish(bundle("preview", "other"), store, key="chair", collection="mine")
    assert set(listed(store)) == {"dress"}
    assert set(listed(store, "mine")) == {"chair"}
    asset = listed(store)["dress"]
    lods = read_entry(store, "dress").document["lods"]
    assert [(file.level, file.url, file.sha256, file.size) for file in asset.files] == [
        (lod["level"], lod["name"], lod["sha256"], lod["bytes"]) for lod in lods
    ]
    publish(bundle("refined"), store, key="dress")
    assert listed(store)["dress"].version == 2


def test_what_was_generated_has_a_label_that_says_so_and_nobody_takes_it_away(store: MemoryStore) -> None:
    made = bundle("preview")
    named = {**made.manifest, "labels": ["Generated", "red"]}
    publish(replace(made, manifest={**named, "origin": "generated"}), store, key="dress")
    assert listed(store)["dress"].labels == ("generated", "red")
    assert read_entry(store, "dress").names.labels == ("Generated", "red")
    publish(replace(bundle("refined", "measured"), manifest={**named, "origin": "measured"}), store, key="chair")
    assert listed(store)["chair"].labels == ("Generated", "red")


def test_a_catalogue_whose_ids_have_no_versions_is_made_anew(store: MemoryStore) -> None:
    """As it was written before: two versions of an asset had one id."""
    publish(bundle("preview"), store, key="dress")
    publish(bundle("preview"), store, key="chair")
    first = catalogue_names("default")[0].catalogue
    old = read_json_catalogue(store.get(first))
    plain = tuple(replace(each, internal_id=each.internal_id.partition("@")[0]) for each in old.locations)
    store.put(first, json_catalogue(replace(old, locations=plain)), content_type="application/json")
    publish(bundle("refined"), store, key="dress")
    assert {key: asset.version for key, asset in listed(store).items()} == {"chair": 1, "dress": 2}
    ids = [each.internal_id for each in read_json_catalogue(store.get(first)).locations]
    assert {"captures/chair@1", "captures/dress@2"} <= set(ids)


def test_a_removed_asset_is_left_out_until_it_is_restored(store: MemoryStore) -> None:
    publish(bundle("preview"), store, key="dress")
    publish(bundle("preview"), store, key="chair")
    remove(store, "dress")
    assert set(listed(store)) == {"chair"}
    restore(store, "dress")
    assert set(listed(store)) == {"chair", "dress"}


def test_rivals_lose_nothing(store: MemoryStore) -> None:
    keys = [f"key{number}" for number in range(12)]
    with ThreadPoolExecutor(6) as pool:
        list(pool.map(lambda key: publish(bundle("preview"), store, key=key), keys))
    assert set(listed(store)) == set(keys)


@pytest.mark.parametrize("damage", [b"", b"{}", b"not json", b"[1,2"])
def test_a_damaged_catalogue_is_made_anew_from_the_entries(store: MemoryStore, damage: bytes) -> None:
    publish(bundle("preview"), store, key="dress")
    publish(bundle("preview"), store, key="chair")
    store.put(catalogue_names("default")[0].catalogue, damage, content_type="application/json", cache_control=NO_CACHE)
    update_collections(store, "dress")
    assert set(listed(store)) == {"chair", "dress"}


def test_what_was_lost_behind_the_table_is_written_again(store: MemoryStore) -> None:
    publish(bundle("preview"), store, key="dress")
    for names in catalogue_names("default")[1:]:
        store.delete(names.catalogue)
        store.delete(names.hash)
    update_collections(store, "dress")
    assert set(listed(store)) == {"dress"}


def test_an_asset_that_unity_would_misread_keeps_nobody_from_publishing(store: MemoryStore) -> None:
    publish(bundle("preview"), store, key="dress")
    document = {**read_entry(store, "dress").document, "labels": list(map(str, range(101)))}
    store.put(entry_name("dress"), json.dumps(document).encode(), content_type="application/json")
    publish(bundle("preview"), store, key="chair")
    update_collections(store, "dress")
    assert set(listed(store)) == {"chair"}
