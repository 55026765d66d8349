"""Publishers of one collection at once: one commits for all, whoever dies, and nobody waits for ever."""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from capture2vr.storage.catalogue import group_commit
from capture2vr.storage.catalogue.collection import row_of
from capture2vr.storage.catalogue.entry import entry_name, read_entry
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.catalogue.reader import read_root
from capture2vr.storage.catalogue.root import root_name
from capture2vr.storage.catalogue.update import update_collections
from capture2vr.storage.memory import MemoryStore
from capture2vr.storage.store import Head, list_all
from tests.support.bundles import Crash, CrashingStore, bundle, listed

LEASE = "collections/default/committer.json"


class Distant(MemoryStore):
    """A store of which every call takes some milliseconds, and which counts the roots that are written."""

    roots = 0

    def put(self, name: str, data: object, **how: object) -> Head:  # type: ignore[override]
        time.sleep(0.004)
        head = super().put(name, data, **how)  # type: ignore[arg-type]
        self.roots += name == root_name("default")
        return head

    def head(self, name: str) -> Head:
        time.sleep(0.004)
        return super().head(name)


def idle(store: MemoryStore) -> bool:
    return not store.list("collections/default/waiting/") and not store.list(LEASE)


@pytest.mark.slow
def test_many_publishers_share_commits_and_none_is_left_out() -> None:
    store = Distant()
    keys = [f"k{number:03d}" for number in range(60)]
    with ThreadPoolExecutor(20) as pool:
        list(pool.map(lambda key: publish(bundle(), store, key=key), keys))
    found = listed(store)
    assert sorted(found) == keys
    assert all(each == row_of(read_entry(store, key)) for key, each in found.items())
    assert store.roots < 45, "commits are shared"
    assert idle(store)


def test_who_is_alone_takes_no_lease() -> None:
    store = MemoryStore()
    publish(bundle(), CrashingStore(store, -1, after=False), key="a")
    assert idle(store)


def test_a_lease_whose_holder_died_is_taken_over(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(group_commit, "_ABANDONED_S", 0.2)
    store = MemoryStore()
    store.put(LEASE, b"{}", content_type="application/json")
    start = time.monotonic()
    publish(bundle(), store, key="a")
    assert time.monotonic() - start >= 0.2
    assert list(listed(store)) == ["a"]
    assert idle(store)


class Killed(CrashingStore):
    """A store whose process dies at the n-th put: nothing that it calls afterwards happens either."""

    is_dead = False

    def put(self, name: str, data: object, **how: object) -> Head:  # type: ignore[override]
        self._check()
        try:
            return super().put(name, data, **how)  # type: ignore[arg-type]
        except Crash:
            self.is_dead = True
            raise

    def head(self, name: str) -> Head:
        self._check()
        return super().head(name)

    def delete(self, name: str) -> None:
        self._check()
        super().delete(name)

    def _check(self) -> None:
        if self.is_dead:
            raise Crash


@pytest.mark.slow
@pytest.mark.parametrize("after", [False, True], ids=["before", "after"])
def test_a_committer_that_dies_at_any_write_leaves_its_work_to_the_next(
    after: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(group_commit, "_ABANDONED_S", 0.1)
    died = 0
    for at in range(1, 30):
        store = MemoryStore()
        publish(bundle(), store, key="first")
        for key in ("a", "b"):
            with pytest.raises(Crash):  # its files and entry are there, its row is not
                publish(bundle(), CrashingStore(store, 8, after=False), key=key)
            store.put(f"collections/default/waiting/{key}.0123456789ab.json", b"{}", content_type="application/json")
        lease = group_commit._Lease(Killed(store, at, after=after), LEASE)
        try:
            assert lease.take()
            group_commit._lead(lease.store, "default", group_commit.Keys(), lease)
        except Crash:
            died += 1
        else:
            break
        assert set(listed(store)) in ({"first"}, {"first", "a", "b"}), "the old state or the new one"
        store.put(LEASE, b"{}", content_type="application/json")  # another one that has just died
        publish(bundle(), store, key="z")
        assert sorted(listed(store)) == ["a", "b", "first", "z"]
        assert idle(store)
    assert died > 3


def test_a_committer_that_wakes_up_late_takes_nothing_back() -> None:
    """It has read root and entries, and sleeps; meanwhile its lease is taken, and newer versions are committed."""
    store = MemoryStore()
    publish(bundle(), store, key="a")
    reached, go_on = threading.Event(), threading.Event()

    class Slow(CrashingStore):
        def put(self, name: str, data: object, **how: object) -> Head:  # type: ignore[override]
            if name == root_name("default") and not reached.is_set():
                reached.set()
                assert go_on.wait(20)
            return super().put(name, data, **how)  # type: ignore[arg-type]

    with ThreadPoolExecutor(1) as pool:
        late = pool.submit(publish, bundle(content="2"), Slow(store, -1, after=False), key="a")
        assert reached.wait(20)
        publish(bundle(content="3"), store, key="a")
        publish(bundle(), store, key="b")
        go_on.set()
        late.result()
    assert {key: each.version for key, each in listed(store).items()} == {"a": 3, "b": 1}
    assert read_root(store, "default").version == 3, "its own change was there already"


def test_a_note_of_what_was_deleted_meanwhile_is_no_fault() -> None:
    store = MemoryStore()
    publish(bundle(), store, key="a")
    store.put("collections/default/waiting/gone.0123456789ab.json", b"{}", content_type="application/json")
    store.put(LEASE, b"{}", content_type="application/json")
    store.delete(LEASE)
    lease = group_commit._Lease(store, LEASE)
    assert lease.take()
    group_commit._lead(store, "default", group_commit.Keys(), lease)
    assert list(listed(store)) == ["a"]
    assert idle(store)


def test_a_damaged_entry_of_somebody_else_holds_up_nobody(caplog: pytest.LogCaptureFixture) -> None:
    store = MemoryStore()
    publish(bundle(), store, key="a")
    for key in ("a", "b"):
        store.put(f"collections/default/waiting/{key}.0123456789ab.json", b"{}", content_type="application/json")
    with pytest.raises(Crash):
        publish(bundle(), CrashingStore(store, 8, after=False), key="b")  # its row is not there
    store.put(entry_name("a"), b"{", content_type="application/json")
    lease = group_commit._Lease(store, LEASE)
    assert lease.take()
    group_commit._lead(store, "default", group_commit.Keys(), lease)
    assert list(listed(store)) == ["a", "b"]
    assert "the row of asset a stays as it is" in caplog.text
    assert idle(store)


def test_a_failing_commit_is_told_to_who_waits_and_leaves_no_note() -> None:
    store = MemoryStore()
    publish(bundle(), store, key="a")
    publish(bundle(), store, key="b")
    (shard,) = read_root(store, "default").parts
    store.put(shard.name, b"{}", content_type="application/json")
    store.put(LEASE, b"{}", content_type="application/json")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(group_commit, "_ABANDONED_S", 0.1)
        with pytest.raises(OSError, match="do not have the hash"):
            publish(bundle(content="2"), store, key="a")
    assert idle(store)
    assert [head.name for head in list_all(store, "collections/default/") if "waiting" in head.name] == []
    with pytest.raises(OSError, match="do not have the hash"):
        update_collections(store, "a")
