"""Deletion for good: nothing of the asset is left anywhere, whatever the moment of a crash, and the others stay."""

from __future__ import annotations

import pytest

from capture2vr.storage.catalogue.deletion import delete_asset, delete_everything
from capture2vr.storage.catalogue.publish import PublishPolicy, publish
from capture2vr.storage.catalogue.reader import read_root
from capture2vr.storage.catalogue.root import index_name, root_name
from capture2vr.storage.catalogue.signing import NO_KEYS, Keys
from capture2vr.storage.catalogue.verify import verify
from capture2vr.storage.memory import MemoryStore
from capture2vr.storage.store import Store, list_all
from capture2vr.storage.tenant_store import store_of_tenant
from tests.storage.catalogue.test_signing import ONE
from tests.support.bundles import Crash, bundle, listed

SIGNED = Keys(signers=(ONE,))
STAYS = [index_name("default"), root_name("default")]
SIGNING = PublishPolicy(SIGNED)


class DyingStore:
    """A store whose process dies at its n-th change, a put or a deletion."""

    def __init__(self, inner: Store, at: int) -> None:
        self._inner = inner
        self._left = at

    def __getattr__(self, name: str) -> object:
        method = getattr(self._inner, name)
        if name not in ("put", "delete"):
            return method

        def change(*args: object, **options: object) -> object:
            self._left -= 1
            if self._left == 0:
                raise Crash(args[0])
            return method(*args, **options)

        return change


def two_assets() -> MemoryStore:
    store = MemoryStore()
    for content in ("first", "second"):
        publish(bundle(content=content, label="Secret gown"), store, key="gown", policy=SIGNING)
    publish(bundle(content="third", label="Secret gown"), store, key="gown", collection="other", policy=SIGNING)
    publish(bundle(content="shoe", label="Shoe"), store, key="shoe", policy=SIGNING)
    return store


def traces(store: Store, text: str) -> list[str]:
    """Objects that have the text in their name or content."""
    return [each.name for each in list_all(store, "") if text in each.name or text.encode() in store.get(each.name)]


def assert_gone(store: Store) -> None:
    assert traces(store, "gown") == []
    assert list(listed(store, believed=SIGNED.verification_keys)) == ["shoe"]
    assert listed(store, "other", SIGNED.verification_keys) == {}
    for collection in ("default", "other"):
        faults = [line.faults for line in verify(lambda name: [store.get(name)], collection, SIGNED.verification_keys)]
        assert not any(faults)


def test_all_versions_go_and_the_other_asset_stays() -> None:
    store = two_assets()
    before = {head.name: head.size for head in list_all(store, "")}
    version = read_root(store, "default", SIGNED.verification_keys).version
    deleted = delete_asset(store, "gown", SIGNED)
    assert_gone(store)
    assert {each.name for each in deleted} >= {name for name in before if name.startswith("assets/gown/")}
    assert all(each.size == before[each.name] for each in deleted if each.name.startswith("assets/"))
    assert all(each.url == store.url(each.name) for each in deleted)
    assert read_root(store, "default").version > version, "clients must not see it go back"
    with pytest.raises(FileNotFoundError):
        delete_asset(store, "gown", SIGNED)


@pytest.mark.slow
def test_after_a_crash_at_any_change_deleting_again_completes_it() -> None:
    changes = 0
    for at in range(1, 200):
        store = two_assets()
        try:
            delete_asset(DyingStore(store, at), "gown", SIGNED)  # type: ignore[arg-type]
        except Crash:
            changes = at
            delete_asset(store, "gown", SIGNED)
            assert_gone(store)
        else:
            break
    assert changes > 20, "the test has seen no crash"


def test_a_key_can_be_used_again() -> None:
    store = two_assets()
    delete_asset(store, "gown", SIGNED)
    assert publish(bundle(content="new"), store, key="gown", policy=SIGNING).version == 1
    assert sorted(listed(store, believed=SIGNED.verification_keys)) == ["gown", "shoe"]


def test_the_rows_of_a_whole_shard(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("capture2vr.storage.catalogue.tree.LEAF_ROWS", 4)
    store = MemoryStore()
    keys = ["a", "b", "c", "d", "e"]
    for key in keys:
        publish(bundle(content=key), store, key=key)
    first, second = read_root(store, "default").parts
    for key in keys[first.count :]:
        delete_asset(store, key)
    assert [shard.first for shard in read_root(store, "default").parts] == [first.first]
    assert sorted(listed(store)) == keys[: first.count]
    publish(bundle(content="f"), store, key=second.first)
    assert sorted(listed(store)) == [*keys[: first.count], second.first]


@pytest.mark.parametrize("crash_at", [None, 1, 2, 3, 5, 8, 13])
def test_everything_of_one_tenant(crash_at: int | None) -> None:
    whole = MemoryStore()
    ada, bob = (store_of_tenant(whole, tenant) for tenant in ("ada", "bob"))
    for store in (whole, ada, bob):
        publish(bundle(label="Secret gown"), store, key="gown", policy=SIGNING)
        store.put("captures/cap_1.zip", b"room", content_type="application/zip")
    before = {name: [head.name for head in list_all(each, "")] for name, each in (("whole", whole), ("bob", bob))}
    if crash_at:
        with pytest.raises(Crash):
            delete_everything(DyingStore(ada, crash_at), SIGNED)  # type: ignore[arg-type]
    deleted, stays = delete_everything(ada, SIGNED)
    assert stays == STAYS == [head.name for head in list_all(ada, "")]
    assert listed(ada, believed=SIGNED.verification_keys) == {}
    assert traces(ada, "gown") == []
    assert [head.name for head in list_all(bob, "")] == before["bob"]
    if not crash_at:
        assert {each.name for each in deleted} >= {"captures/cap_1.zip", "catalog/gown.json"}
    deleted, _ = delete_everything(whole, SIGNED)
    assert [head.name for head in list_all(bob, "")] == before["bob"], "the default tenant's store holds the others"
    assert delete_everything(ada, SIGNED) == ([], STAYS)


def test_everything_goes_where_the_catalogue_is_damaged() -> None:
    store = MemoryStore()
    publish(bundle(), store, key="gown", policy=SIGNING)
    for name in ("catalog/gown.json", *STAYS):
        store.put(name, b"{", content_type="application/json")
    delete_everything(store, SIGNED)
    assert listed(store, believed=SIGNED.verification_keys) == {}
    assert [head.name for head in list_all(store, "")] == STAYS


def test_a_signed_collection_is_not_emptied_without_the_key() -> None:
    store = two_assets()
    before = {head.name: store.get(head.name) for head in list_all(store, "")}
    with pytest.raises(OSError, match="no key to sign"):
        delete_everything(store, NO_KEYS)
    assert {head.name: store.get(head.name) for head in list_all(store, "")} == before
