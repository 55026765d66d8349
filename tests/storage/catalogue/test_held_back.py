"""Versions whose grade says to shoot again: nothing is lost, nothing good is replaced, and one action keeps them."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from capture2vr.storage.bundle import Bundle, State, sha256_hex
from capture2vr.storage.catalogue.change_entry import change_names, remove
from capture2vr.storage.catalogue.collection import read_shard, row_of, shard_data
from capture2vr.storage.catalogue.entry import Entry, alias_name, read_entry
from capture2vr.storage.catalogue.notes_update import add_note
from capture2vr.storage.catalogue.proof import check_proof
from capture2vr.storage.catalogue.publish import PublishPolicy, publish
from capture2vr.storage.catalogue.reader import read_root
from capture2vr.storage.catalogue.root import root_name
from capture2vr.storage.catalogue.signing import Keys
from capture2vr.storage.catalogue.update import rebuild
from capture2vr.storage.catalogue.versions import read_version, restore_version
from capture2vr.storage.memory import MemoryStore
from capture2vr.storage.store import list_all
from capture2vr.storage.unity.json_reader import read_json_catalogue
from capture2vr.storage.unity.locations import parse_assets
from capture2vr.storage.unity.publication import catalogue_names
from tests.storage.catalogue.test_signing import ONE
from tests.support.bundles import Crash, CrashingStore, bundle, listed


def graded(level: str, state: State = "refined", content: str = "a") -> Bundle:
    grade = {"level": level, "because": "it is in shreds", "advice": "Make it matt."}
    return bundle(state, content, quality={"triangles": 100, "grade": grade})


def in_unity(store: MemoryStore) -> dict[str, int]:
    """Versions by key in the Unity catalogue of the default collection."""
    assets = parse_assets(read_json_catalogue(store.get(catalogue_names("default")[0].catalogue)))
    return {asset.key: asset.version for asset in assets}


def facts(entry: Entry) -> dict[str, object]:
    """An entry without its list of versions."""
    return {name: value for name, value in entry.document.items() if name != "versions"}


def test_the_first_version_of_a_key_is_there_for_its_owner_alone() -> None:
    store = MemoryStore()
    asset = publish(graded("shoot again"), store, key="dress", job="job_1")
    entry = read_entry(store, "dress")
    assert (asset.held, entry.held, entry.version, entry.grade) == (True, True, 1, "shoot again")
    assert all(store.head(file["name"]) for file in entry.document["files"])
    assert (listed(store), in_unity(store)) == ({}, {})
    assert not [head.name for head in list_all(store, "alias/")]
    rebuild(store, "default")
    rebuild(store, "default")
    assert (listed(store), in_unity(store)) == ({}, {}), "nor does a catalogue that is written anew list it"


def test_a_better_version_goes_on_being_served() -> None:
    store = MemoryStore()
    publish(graded("good"), store, key="dress", job="job_1")
    add_note(store, "dress", text="a tear", at=(0.5, 1, 1), normal=None, author="ada")
    before, row, alias = read_entry(store, "dress"), listed(store)["dress"], store.get(alias_name("dress"))
    asset = publish(graded("shoot again"), store, key="dress", job="job_2")
    entry = read_entry(store, "dress")
    assert (asset.version, asset.held, entry.held) == (2, True, False)
    assert facts(entry) == facts(before)
    assert (listed(store)["dress"], store.get(alias_name("dress")), in_unity(store)) == (row, alias, {"dress": 1})
    held = read_version(store, "dress", 2)
    assert (held.held, held.grade, json.loads(store.get(held.manifest))["key"]) == (True, "shoot again", "dress")
    publish(graded("usable"), store, key="dress", job="job_3")
    assert (listed(store)["dress"].version, listed(store)["dress"].grade) == (3, "usable")


@pytest.mark.parametrize("earlier", ["good", ""])
def test_keeping_it_publishes_it(earlier: str) -> None:
    store = MemoryStore()
    if earlier:
        publish(graded(earlier), store, key="dress", job="job_1")
    held = publish(graded("shoot again"), store, key="dress", job="job_2")
    entry = restore_version(store, "dress", held.version)
    row = listed(store)["dress"]
    assert (entry.held, entry.manifest, entry.versions[-1]["restored"]) == (False, held.manifest, held.version)
    assert (row.version, row.grade, in_unity(store)) == (held.version + 1, "shoot again", {"dress": held.version + 1})
    assert json.loads(store.get(alias_name("dress")))["manifest"] == held.manifest
    assert restore_version(store, "dress", held.version).version == entry.version, "twice is once"
    publish(graded("shoot again", content="edited"), store, key="dress", job="job_3")
    assert listed(store)["dress"].version == entry.version + 1, "what somebody has kept may be edited"


def test_a_draft_is_held_back_too_and_its_better_refinement_is_published() -> None:
    store = MemoryStore()
    publish(graded("shoot again", "preview"), store, key="dress", job="job_1")
    change_names(store, "dress", label="Named meanwhile")
    publish(graded("incomplete", "refined"), store, key="dress", job="job_1")
    row = listed(store)["dress"]
    assert (row.version, row.state, row.grade, row.label) == (2, "refined", "incomplete", "Named meanwhile")


def test_who_asks_for_it_has_it_published() -> None:
    store = MemoryStore()
    publish(graded("good"), store, key="dress", job="job_1")
    asset = publish(graded("shoot again"), store, key="dress", job="job_2", policy=PublishPolicy(anyway=True))
    assert (asset.held, listed(store)["dress"].version, read_entry(store, "dress").held) == (False, 2, False)


def test_what_was_removed_stays_removed() -> None:
    store = MemoryStore()
    publish(graded("good"), store, key="dress", job="job_1")
    remove(store, "dress")
    publish(graded("shoot again"), store, key="dress", job="job_2")
    assert (read_entry(store, "dress").removed, listed(store)["dress"].removed) == (True, True)
    restore_version(store, "dress", 2)
    assert (listed(store)["dress"].removed, listed(store)["dress"].version) == (False, 3)


def test_a_held_version_leaves_the_signature_of_the_served_one() -> None:
    store, keys = MemoryStore(), Keys(signers=(ONE,))
    publish(graded("good"), store, key="dress", job="job_1", policy=PublishPolicy(keys))
    publish(graded("shoot again"), store, key="dress", job="job_2", policy=PublishPolicy(keys))
    assert check_proof("dress", read_entry(store, "dress").document, keys.verification_keys) == 1
    restore_version(store, "dress", 2, keys)
    assert check_proof("dress", read_entry(store, "dress").document, keys.verification_keys) == 3
    assert listed(store, believed=keys.verification_keys)["dress"].version == 3


@pytest.mark.parametrize("earlier", ["good", ""])
def test_a_crash_at_any_put_leaves_what_was_served_and_the_next_run_completes_it(earlier: str) -> None:
    bad, at, has_crashed = graded("shoot again", content="other files"), 0, True
    while has_crashed:
        at += 1
        for after in (False, True):
            store, has_crashed = MemoryStore(), False
            if earlier:
                publish(graded(earlier), store, key="dress", job="job_1")
            try:
                publish(bad, CrashingStore(store, at, after=after), key="dress", job="job_2")
            except Crash:
                has_crashed = True
            served = {"dress": 1} if earlier else {}
            has_index = any(root_name("default") == head.name for head in list_all(store, "collections/"))
            assert {row.key: row.version for row in (listed(store) if has_index else {}).values()} == served
            publish(bad, store, key="dress", job="job_2")
            assert {row.key: row.version for row in listed(store).values()} == served
            assert [each.get("held", False) for each in read_entry(store, "dress").versions][-1:] == [True]
    assert at > 5, "files, manifest and entry were among the puts"


def test_entries_and_shards_of_before_have_no_grade() -> None:
    store = MemoryStore()
    publish(bundle(), store, key="dress")
    entry = read_entry(store, "dress")
    old = Entry("dress", "", {name: value for name, value in entry.document.items() if name != "grade"})
    assert (old.grade, old.held, row_of(old).grade) == ("", False, "")
    shard = read_root(store, "default").parts[0]
    document = json.loads(shard_data([row_of(old)], "1"))
    place = document["columns"].index("grade")
    cells = [[cell for number, cell in enumerate(row) if number != place] for row in document["rows"]]
    columns = [each for each in document["columns"] if each != "grade"]
    data = json.dumps({**document, "columns": columns, "rows": cells}).encode()
    assert read_shard(data, replace(shard, sha256=sha256_hex(data))) == (row_of(old),)
