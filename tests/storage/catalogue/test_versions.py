"""Earlier versions: each is read as it was, and one is restored under a new number, signed, whatever came between."""

from __future__ import annotations

import json

import pytest

from capture2vr.storage.catalogue.change_entry import change_names, remove
from capture2vr.storage.catalogue.entry import alias_name, read_entry
from capture2vr.storage.catalogue.faults import FILE_MISSING, MANIFEST_CHANGED, MANIFEST_MISSING, CatalogueFault
from capture2vr.storage.catalogue.proof import check_proof
from capture2vr.storage.catalogue.publish import PublishPolicy, publish
from capture2vr.storage.catalogue.signing import Keys
from capture2vr.storage.catalogue.versions import UnknownVersion, read_version, restore_version
from capture2vr.storage.memory import MemoryStore
from tests.storage.catalogue.test_signing import ONE
from tests.support.bundles import bundle, listed


@pytest.fixture
def store() -> MemoryStore:
    """An asset of three versions."""
    store = MemoryStore()
    for number in (1, 2, 3):
        publish(bundle("refined", content=f"content {number}"), store, key="dress", job=f"job_{number}")
    return store


def files(document: object) -> object:
    return [document[field] for field in ("manifest", "lods", "files", "preview", "size_m", "state")]  # type: ignore[index]


def test_a_version_is_read_as_it_was(store: MemoryStore) -> None:
    fresh = MemoryStore()
    for number in (1, 2, 3):
        publish(bundle("refined", content=f"content {number}"), fresh, key="dress", job=f"job_{number}")
        assert files(read_version(store, "dress", number).document) == files(read_entry(fresh, "dress").document)
        assert read_version(store, "dress", number).version == number


def test_the_version_before_is_restored_as_the_newest(store: MemoryStore) -> None:
    change_names(store, "dress", label="Named later")
    before = read_version(store, "dress", 2)
    entry = restore_version(store, "dress", 2)
    assert (entry.version, [each["version"] for each in entry.versions]) == (4, [1, 2, 3, 4])
    assert files(entry.document) == files(before.document)
    assert entry.names.label == "Named later"
    assert (entry.versions[-1]["job"], entry.versions[-1]["restored"]) == ("job_2", 2)
    assert entry.document["updated"] >= entry.versions[-1]["created"]
    assert json.loads(store.get(alias_name("dress"))) == {"version": 4, "manifest": entry.manifest}
    assert listed(store)["dress"].version == 4


def test_restoring_twice_is_restoring_once(store: MemoryStore) -> None:
    restore_version(store, "dress", 1)
    assert restore_version(store, "dress", 1).version == 4
    assert restore_version(store, "dress", 4).version == 4
    assert restore_version(store, "dress", 3).version == 5, "and the undo can be undone"


def test_a_restored_version_does_not_stop_later_jobs(store: MemoryStore) -> None:
    restore_version(store, "dress", 1)
    assert publish(bundle("refined", content="content 3"), store, key="dress", job="job_3").version == 3, "done already"
    assert publish(bundle("refined", content="new"), store, key="dress", job="job_4").version == 5
    assert read_entry(store, "dress").version == 5


def test_a_removed_asset_is_shown_again(store: MemoryStore) -> None:
    remove(store, "dress")
    entry = restore_version(store, "dress", 3)
    assert (entry.removed, entry.version) == (False, 4)


def test_it_is_signed() -> None:
    signed, keys = MemoryStore(), Keys(signers=(ONE,))
    for number in (1, 2):
        made = bundle("refined", content=f"content {number}")
        publish(made, signed, key="dress", job=f"job_{number}", policy=PublishPolicy(keys))
    entry = restore_version(signed, "dress", 1, keys)
    assert check_proof("dress", entry.document, keys.verification_keys, at_least=3) == 3


def test_what_there_is_not_has_a_name(store: MemoryStore) -> None:
    with pytest.raises(UnknownVersion, match="asset dress has no version 9; it has 1, 2, 3"):
        restore_version(store, "dress", 9)
    with pytest.raises(FileNotFoundError):
        read_version(store, "coat", 1)


def test_files_that_are_gone_stop_it_before_anything_changes(store: MemoryStore) -> None:
    one, two = (read_version(store, "dress", number) for number in (1, 2))
    own = next(file["name"] for file in one.document["files"] if file not in two.document["files"])
    store.delete(own)
    with pytest.raises(CatalogueFault) as missing:
        restore_version(store, "dress", 1)
    assert missing.value.code == FILE_MISSING
    store.put(two.manifest, b"{}", content_type="application/json")
    with pytest.raises(CatalogueFault) as changed:
        restore_version(store, "dress", 2)
    assert changed.value.code == MANIFEST_CHANGED
    store.delete(two.manifest)
    with pytest.raises(CatalogueFault) as gone:
        restore_version(store, "dress", 2)
    assert gone.value.code == MANIFEST_MISSING
    assert read_entry(store, "dress").version == 3
