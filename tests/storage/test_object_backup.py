"""Objects are copied to a folder and back: same names, bytes and types; a second copy reads only what is new."""

from __future__ import annotations

from pathlib import Path

import pytest

from capture2vr.storage.bundle import sha256_of
from capture2vr.storage.catalogue.change_entry import remove
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.catalogue.verify import fetch_from, verify
from capture2vr.storage.local import LocalStore
from capture2vr.storage.memory import MemoryStore
from capture2vr.storage.object_backup import (
    StoredObject,
    compare,
    content_path,
    copy_objects,
    list_objects,
    restore_objects,
    unexpected_objects,
)
from capture2vr.storage.store import NO_CACHE, Head, Store, list_all
from capture2vr.storage.tenant_store import PrefixStore
from tests.support.bundles import bundle


def fill(store: Store) -> None:
    publish(bundle(), store, key="dress", job="job_1", fence=3)
    publish(bundle(content="b"), store, key="hat")
    store.put("captures/cap_1.zip", b"photos" * 9, content_type="application/zip", cache_control="private, no-store")
    store.put("uploads/up_1.0", b"part", content_type="application/octet-stream", cache_control=NO_CACHE)


def contents(store: Store) -> dict[str, tuple[bytes, str, str]]:
    return {
        head.name: (store.get(head.name), *_types(store.head(head.name)))
        for head in list_all(store, "")
        if not head.name.startswith("uploads/")
    }


def _types(head: Head) -> tuple[str, str]:
    return head.content_type, head.cache_control


def copy(store: Store, folder: Path, known: list[StoredObject] | None = None) -> list[StoredObject]:
    folder.mkdir(exist_ok=True)
    return list(copy_objects(store, folder, {each.name: each for each in known or []}))


def test_a_copy_comes_back_as_it_was(store: Store, tmp_path: Path) -> None:
    fill(store)
    inventory = copy(store, tmp_path / "copy")
    before = contents(store)
    assert {each.name: each.size for each in inventory} == {name: len(was[0]) for name, was in before.items()}
    for each in inventory:
        assert sha256_of(content_path(tmp_path / "copy", each.sha256)) == each.sha256
    for head in list(list_all(store, "")):
        store.delete(head.name)
    assert restore_objects(store, tmp_path / "copy", inventory) == len(inventory)
    assert contents(store) == before
    assert not list(verify(fetch_from(store), "default", ()))[-1].faults
    assert unexpected_objects(store, inventory) == []
    assert restore_objects(store, tmp_path / "copy", inventory) == 0, "what is there is not written again"
    found = compare(store, inventory)
    assert (found.missing, found.changed, found.newer) == ((), (), ())


def test_a_second_copy_reads_only_what_is_new(tmp_path: Path) -> None:
    class Counting(MemoryStore):
        def fetch(self, name: str, path: Path) -> None:
            fetched.append(name)
            super().fetch(name, path)

    fetched: list[str] = []
    store = Counting()
    fill(store)
    first = copy(store, tmp_path / "copy")
    assert sorted(fetched) == sorted(each.name for each in first)
    fetched.clear()
    assert copy(store, tmp_path / "copy", first) == first
    assert fetched == []
    publish(bundle(content="c"), store, key="shoe")
    second = copy(store, tmp_path / "copy", first)
    new = {each.name for each in second} - {each.name for each in first}
    assert {name for name in fetched if "/shoe/" in name} == {name for name in new if "/shoe/" in name}
    assert not any("/dress/" in name for name in fetched)
    content_path(tmp_path / "copy", second[0].sha256).unlink()
    assert copy(store, tmp_path / "copy", second) == second, "a content that is gone from the folder is read again"


def test_what_is_published_meanwhile_is_whole_or_absent(tmp_path: Path) -> None:
    """A publisher that writes a new version between any two reads: the copy's catalogue never lacks a file."""

    class Busy(MemoryStore):
        def fetch(self, name: str, path: Path) -> None:
            super().fetch(name, path)
            if len(made) < 6:
                made.append(name)
                publish(bundle(content=str(len(made))), self, key=f"dress{len(made) % 3}")

    made: list[str] = []
    store = Busy()
    publish(bundle(), store, key="dress0")
    made.clear()
    inventory = copy(store, tmp_path / "copy")
    assert made
    restored = MemoryStore()
    restore_objects(restored, tmp_path / "copy", inventory)
    assert not list(verify(fetch_from(restored), "default", ()))[-1].faults


def test_what_is_deleted_meanwhile_is_left_out(tmp_path: Path) -> None:
    class Forgetful(MemoryStore):
        def fetch(self, name: str, path: Path) -> None:
            self.delete("captures/cap_1.zip")
            super().fetch(name, path)

    store = Forgetful()
    fill(store)
    names = {each.name for each in copy(store, tmp_path / "copy")}
    assert "captures/cap_1.zip" not in names
    assert "alias/dress/latest.json" in names
    assert [path for path in (tmp_path / "copy").iterdir() if path.is_file()] == []


def test_tenants_are_copied_with_their_prefix_and_parts_of_uploads_are_not(tmp_path: Path) -> None:
    store = MemoryStore()
    fill(PrefixStore(store, "tenants/ada/"))
    names = {each.name for each in copy(store, tmp_path / "copy")}
    assert "tenants/ada/catalog/dress.json" in names
    assert not any("uploads/" in name for name in names)
    assert names == {each.name for each in list_objects(store)}


def test_an_inventory_tells_what_a_store_has_lost(tmp_path: Path) -> None:
    store = LocalStore(tmp_path / "objects")
    fill(store)
    inventory = list(list_objects(store))
    lost, spoiled = (next(each.name for each in inventory if part in each.name) for part in ("lod0", "lod1"))
    store.delete(lost)
    store.put(spoiled, b"x" * store.head(spoiled).size, content_type="model/gltf-binary")
    publish(bundle(content="c"), store, key="shoe")
    found = compare(store, inventory)
    assert (found.missing, found.changed) == ((lost,), (spoiled,))
    assert "collections/default/index.json" in found.newer


def test_a_restored_bucket_of_another_kind_is_compared_by_sizes(tmp_path: Path) -> None:
    """S3's etag of an object that was uploaded in parts depends on the parts."""
    store = MemoryStore()
    store.put("captures/cap_1.zip", b"photos", content_type="application/zip")
    parts = StoredObject("captures/cap_1.zip", 6, "d41d8cd98f00b204e9800998ecf8427e-3")
    assert compare(store, [parts]).changed == ()
    assert compare(store, [StoredObject("captures/cap_1.zip", 7, "0-3")]).changed == ("captures/cap_1.zip",)


@pytest.mark.parametrize("other", [b"another", b"photoz"])
def test_a_store_with_other_things_is_named(other: bytes, tmp_path: Path) -> None:
    store = MemoryStore()
    store.put("captures/cap_1.zip", b"photos", content_type="application/zip")
    inventory = copy(store, tmp_path / "copy")
    assert unexpected_objects(store, inventory) == []
    store.put("captures/cap_1.zip", other, content_type="application/zip")
    store.put("captures/cap_2.zip", b"", content_type="application/zip")
    assert unexpected_objects(store, inventory) == ["captures/cap_1.zip", "captures/cap_2.zip"]


def test_removal_is_restored_too(tmp_path: Path) -> None:
    store, restored = MemoryStore(), MemoryStore()
    fill(store)
    remove(store, "hat")
    restore_objects(restored, tmp_path / "copy", copy(store, tmp_path / "copy"))
    assert contents(restored) == contents(store)
