"""Collections: what was published is listed, signed, in order; whatever crashes, races, rots or is forged."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.storage.catalogue import retired
from capture2vr.storage.catalogue.change_entry import remove, restore
from capture2vr.storage.catalogue.collection import Row, read_shard, row_of, shard_data
from capture2vr.storage.catalogue.collection import describe_shard as as_listed
from capture2vr.storage.catalogue.compare_and_swap import canonical_json
from capture2vr.storage.catalogue.entry import entry_name, read_entry
from capture2vr.storage.catalogue.faults import (
    CATALOGUE_OLDER,
    CATALOGUE_OTHER,
    CATALOGUE_TRUNCATED,
    KEY_UNKNOWN,
    SHARD_CHANGED,
    SHARD_MISSING,
    SIGNATURE_MISSING,
    SIGNATURE_WRONG,
    SIGNING_KEY_MISSING,
    CatalogueFault,
)
from capture2vr.storage.catalogue.publish import KeyElsewhere, PublishedAsset, PublishPolicy, publish
from capture2vr.storage.catalogue.root import Index, index_name, parse_envelope, read_index, root_name, sign_index
from capture2vr.storage.catalogue.signing import Keys
from capture2vr.storage.catalogue.update import rebuild, update_collections
from capture2vr.storage.local import LocalStore
from capture2vr.storage.memory import MemoryStore
from capture2vr.storage.store import Head, Store, list_all
from tests.referees.s3.server import S3Server
from tests.storage.catalogue.test_publish import _in_processes
from tests.storage.catalogue.test_signing import ONE, TWO
from tests.storage.conftest import s3_store
from tests.support.bundles import Crash, CrashingStore, bundle, listed

SIGNED = Keys(signers=(ONE,))
SIGNING = PublishPolicy(SIGNED)
INDEX = root_name("default")

rows = st.builds(
    Row,
    key=st.from_regex(r"[A-Za-z0-9][A-Za-z0-9._-]{0,20}", fullmatch=True),
    label=st.text(max_size=20),
    labels=st.lists(st.text(max_size=8), max_size=4).map(tuple),
    version=st.integers(1, 10**9),
    state=st.sampled_from(["preview", "refined", "removed"]),
    updated=st.integers(0, 2**40),
    manifest=st.binary(min_size=32, max_size=32).map(bytes.hex),
    preview=st.sampled_from(["", "0f" * 32]),
    bytes=st.integers(0, 2**50),
)


def index_of(store: Store, keys: Keys = SIGNED) -> Index:
    return read_index(store.get(INDEX), "default", keys.verification_keys)


def fault_of(call: Callable[[], object]) -> str:
    with pytest.raises(CatalogueFault) as caught:
        call()
    return caught.value.code


def test_a_published_asset_is_listed_with_what_finds_the_rest(store: Store) -> None:
    publish(bundle(labels=["shoe", "Größe 42"]), store, key="dress", policy=SIGNING)
    row = listed(store, believed=SIGNED.verification_keys)["dress"]
    present = read_entry(store, "dress")
    assert row == row_of(present)
    assert (row.label, row.labels, row.version, row.state) == ("Dress", ("shoe", "Größe 42"), 1, "preview")
    assert row.manifest_name == present.manifest
    assert row.preview_name == present.document["preview"]["name"]
    assert json.loads(store.get(row.manifest_name))["files"][0]["bytes"] > 0
    assert index_of(store).version == 1
    publish(bundle("refined"), store, key="dress", policy=SIGNING)
    publish(bundle(), store, key="chair", policy=SIGNING)
    assert [(row.key, row.version, row.state) for row in listed(store).values()] == [
        ("chair", 1, "preview"),
        ("dress", 2, "refined"),
    ]
    assert index_of(store).version == 3


@pytest.mark.slow
@given(st.lists(rows, min_size=1, max_size=20, unique_by=lambda row: row.key))
def test_a_shard_comes_back_as_it_was(many: list[Row]) -> None:
    many.sort(key=lambda row: row.key)
    data = shard_data(many, "ab")
    shard = as_listed("default", many, data)
    assert read_shard(data, shard) == tuple(many)
    for broken in (data[:-1], data + b" ", b"", data.replace(b'"commit":"ab"', b'"commit":"ac"')):
        assert fault_of(lambda data=broken: read_shard(data, shard)) == SHARD_CHANGED


def test_repeating_writes_nothing(store: Store) -> None:
    publish(bundle(), store, key="dress", job="job_1", policy=SIGNING)
    before = {head.name: head.etag for head in list_all(store, "")}
    publish(bundle(), store, key="dress", job="job_1", policy=SIGNING)
    assert {head.name: head.etag for head in list_all(store, "")} == before


@pytest.mark.parametrize("after", [False, True], ids=["before", "after"])
def test_a_run_completes_what_another_left_out_of_the_collection(after: bool) -> None:
    store = MemoryStore()
    publish(bundle(content="old"), store, key="dress", job="job_1", policy=SIGNING)
    with pytest.raises(Crash, match="shard"):
        publish(bundle(content="new"), CrashingStore(store, 8, after=after), key="dress", job="job_2", policy=SIGNING)
    assert (read_entry(store, "dress").version, listed(store)["dress"].version) == (2, 1)
    publish(bundle(content="new"), store, key="dress", job="job_2", policy=SIGNING)
    assert listed(store, believed=SIGNED.verification_keys)["dress"] == row_of(read_entry(store, "dress"))


def test_a_collection_per_user_and_an_asset_in_two() -> None:
    store = MemoryStore()
    publish(bundle(), store, key="a", collection="ada", policy=SIGNING)
    publish(bundle(), store, key="b", collection="bob", policy=SIGNING)
    publish(bundle(content="2"), store, key="a", collection="bob", policy=SIGNING)
    assert (list(listed(store, "ada")), list(listed(store, "bob"))) == (["a"], ["a", "b"])
    assert listed(store, "ada")["a"].version == 2  # a new version is seen wherever the asset is
    remove(store, "a", SIGNED)
    assert listed(store, "ada")["a"].removed
    assert listed(store, "bob")["a"].removed
    with pytest.raises(FileNotFoundError):
        listed(store)


def test_who_publishes_for_others_does_not_take_their_keys() -> None:
    """Two first jobs at once: whoever comes behind changes nothing, even if it found nothing when it began."""
    store = MemoryStore()

    class Late(CrashingStore):
        def put(self, name: str, *args: Any, **options: Any) -> Head:
            if name.startswith("catalog/") and not entries:
                entries.append(publish(bundle(content="hers"), store, key="a", job="job_1", collection="ada"))
            return super().put(name, *args, **options)

    entries: list[PublishedAsset] = []
    alone, late = PublishPolicy(allow_other_collections=False), Late(store, -1, after=False)
    with pytest.raises(KeyElsewhere, match="in collection ada, not in bob"):
        publish(bundle(content="his"), late, key="a", job="job_2", collection="bob", policy=alone)
    assert (read_entry(store, "a").version, read_entry(store, "a").collections) == (1, ["ada"])
    assert publish(bundle("refined"), store, key="a", job="job_1", collection="ada", policy=alone).version == 2
    with pytest.raises(FileNotFoundError):
        listed(store, "bob")


def test_the_same_content_enters_another_collection_without_a_version() -> None:
    store = MemoryStore()
    for collection in ("ada", "bob"):
        assert publish(bundle(), store, key="a", job="job_1", collection=collection).version == 1
    assert list(listed(store, "ada")) == list(listed(store, "bob")) == ["a"]


def test_removed_then_restored(store: Store) -> None:
    publish(bundle(), store, key="dress", job="job_1", policy=SIGNING)
    files = {head.name for head in list_all(store, "assets/")}
    for _ in range(2):
        assert remove(store, "dress", SIGNED).removed
        assert listed(store)["dress"].state == "removed"
    assert index_of(store).version == 2
    remove(CrashingStore(store, 1, after=False), "dress", SIGNED)  # nothing is left to write
    assert {head.name for head in list_all(store, "assets/")} == files
    # A repetition of the job that made it does not bring it back; that would undo what a person did.
    publish(bundle(), store, key="dress", job="job_1", policy=SIGNING)
    assert read_entry(store, "dress").removed
    assert not restore(store, "dress", SIGNED).removed
    assert (listed(store)["dress"].state, listed(store)["dress"].version) == ("preview", 1)


def test_a_new_version_brings_a_removed_asset_back() -> None:
    store = MemoryStore()
    publish(bundle(), store, key="dress", job="job_1")
    remove(store, "dress")
    publish(bundle(content="new"), store, key="dress", job="job_2")
    assert not read_entry(store, "dress").removed
    assert (listed(store)["dress"].state, listed(store)["dress"].version) == ("preview", 2)


def test_what_is_not_there_cannot_be_removed() -> None:
    for mark in (remove, restore):
        with pytest.raises(FileNotFoundError):
            mark(MemoryStore(), "dress")


BAD_NAMES = ["", ".a", "a/b", "..", "../a", "a b", "ä", "\N{GREEK SMALL LETTER ALPHA}", "x" * 300, "a\n", "a\\b", "a\0"]


@pytest.mark.parametrize("name", BAD_NAMES)
def test_impossible_names_are_refused_before_anything_is_written(name: str) -> None:
    store = MemoryStore()
    for call in (
        lambda: publish(bundle(), store, key=name),
        lambda: publish(bundle(), store, key="a", collection=name),
        lambda: remove(store, name),
        lambda: restore(store, name),
        lambda: rebuild(store, name),
    ):
        with pytest.raises(ValueError, match="begin with a letter or digit"):
            call()
    assert store.list("") == []


def test_a_forged_an_older_and_a_broken_index_have_names() -> None:
    store = MemoryStore()
    publish(bundle(), store, key="a", policy=SIGNING)
    first = store.get(INDEX)
    publish(bundle(), store, key="b", policy=SIGNING)
    data = store.get(INDEX)
    envelope = json.loads(data)
    forged = envelope["signed"].replace('"version":2', '"version":9')
    assert forged != envelope["signed"]

    def read(data: bytes, keys: Keys = SIGNED, at_least: int = 0, collection: str = "default") -> Index:
        return read_index(data, collection, keys.verification_keys, at_least=at_least)

    assert read(data, at_least=2).version == 2
    assert fault_of(lambda: read(canonical_json({**envelope, "signed": forged}))) == SIGNATURE_WRONG
    assert fault_of(lambda: read(canonical_json({**envelope, "signatures": []}))) == SIGNATURE_MISSING
    assert fault_of(lambda: read(data, Keys(trusted=(TWO.public,)))) == KEY_UNKNOWN
    assert fault_of(lambda: read(first, at_least=2)) == CATALOGUE_OLDER
    assert fault_of(lambda: read(data, collection="other")) == CATALOGUE_OTHER
    for cut in range(0, len(data), 7):
        assert fault_of(lambda cut=cut: read(data[:cut])) == CATALOGUE_TRUNCATED
    for broken in (b"[]", b"{}", b'{"signed":1,"signatures":[]}', b'{"signed":"","signatures":[{}]}', b"\xff", b"1"):
        assert fault_of(lambda data=broken: read(data)) == CATALOGUE_TRUNCATED
    assert fault_of(lambda: read(b'{"signed":"{}","signatures":[]}', Keys())) == CATALOGUE_TRUNCATED


@pytest.mark.slow
@given(st.text(max_size=60), st.lists(st.dictionaries(st.sampled_from(["key", "ed25519"]), st.text()), max_size=2))
def test_nothing_but_a_fault_comes_of_any_envelope(text: str, signatures: list[dict[str, str]]) -> None:
    for believed in ((), SIGNED.verification_keys):
        with pytest.raises(CatalogueFault):
            read_index(json.dumps({"signed": text, "signatures": signatures}).encode(), "default", believed)


@pytest.mark.parametrize("keys", [Keys(), Keys(trusted=(ONE.public,))], ids=["none", "only-trusted"])
def test_who_cannot_sign_does_not_touch_what_is_signed(keys: Keys) -> None:
    store = MemoryStore()
    publish(bundle(), store, key="a", policy=SIGNING)
    before = store.get(INDEX)
    assert fault_of(lambda: publish(bundle(), store, key="b", policy=PublishPolicy(keys))) == SIGNING_KEY_MISSING
    assert store.get(INDEX) == before


@pytest.mark.parametrize(
    ("damage", "code"),
    [
        (lambda data: data[: len(data) // 2], CATALOGUE_TRUNCATED),
        (lambda data: b"", CATALOGUE_TRUNCATED),
        (lambda data: canonical_json({**json.loads(data), "signatures": []}), SIGNATURE_MISSING),
        (lambda data: data.replace(b"children", b"cHildren"), SIGNATURE_WRONG),
        (lambda data: sign_index(read_index(data, "default"), [TWO]), KEY_UNKNOWN),
    ],
)
def test_a_damaged_index_is_not_built_upon_until_somebody_says_so(damage: Callable[[bytes], bytes], code: str) -> None:
    """Signing what a stranger has put there would make it ours."""
    store = MemoryStore()
    publish(bundle(), store, key="a", policy=SIGNING)
    store.put(INDEX, damage(store.get(INDEX)), content_type="application/json")
    damaged = store.get(INDEX)
    assert fault_of(lambda: publish(bundle(), store, key="b", policy=SIGNING)) == code
    assert store.get(INDEX) == damaged
    assert read_entry(store, "b").version == 1  # by its key it is there
    rebuild(store, "default", SIGNED)
    assert list(listed(store, believed=SIGNED.verification_keys)) == ["a", "b"]


@pytest.mark.parametrize(("put", "code"), [(b"{}", SHARD_CHANGED), (None, SHARD_MISSING)])
def test_a_damaged_shard_is_not_built_upon(put: bytes | None, code: str) -> None:
    store = MemoryStore()
    publish(bundle(), store, key="a", policy=SIGNING)
    (shard,) = index_of(store).parts
    if put is None:
        store.delete(shard.name)
    else:
        store.put(shard.name, put, content_type="application/json")
    before = store.get(INDEX)
    assert fault_of(lambda: publish(bundle(), store, key="b", policy=SIGNING)) == code
    assert store.get(INDEX) == before
    assert rebuild(store, "default", SIGNED).version > 1_700_000_000  # beyond whatever was counted before
    publish(bundle(content="2"), store, key="b", policy=SIGNING)
    assert listed(store, believed=SIGNED.verification_keys)["b"].version == 2


def test_keys_are_exchanged_without_a_moment_in_which_a_client_refuses() -> None:
    store = MemoryStore()
    publish(bundle(), store, key="a", policy=SIGNING)
    both = Keys(signers=(TWO, ONE))
    publish(bundle(), store, key="b", policy=PublishPolicy(both))
    for believed in ((ONE.public,), (TWO.public,)):
        read_index(store.get(INDEX), "default", believed)
    new = Keys(signers=(TWO,), trusted=(ONE.public,))
    rebuild(store, "default", new)
    assert [each["key"] for each in parse_envelope(store.get(INDEX), "default")[1]] == [TWO.public.id]
    publish(bundle(), store, key="c", policy=PublishPolicy(Keys(signers=(TWO,))))
    assert list(listed(store, believed=(TWO.public,))) == ["a", "b", "c"]


def test_assets_older_than_collections_belong_to_the_default_one() -> None:
    store = MemoryStore()
    publish(bundle(), store, key="old")
    old = {key: value for key, value in read_entry(store, "old").document.items() if key != "collections"}
    for head in list_all(store, "collections/"):
        store.delete(head.name)
    store.put(entry_name("old"), canonical_json(old), content_type="application/json")
    publish(bundle(), store, key="ours", collection="mine")
    rebuild(store, "default", SIGNED)
    assert list(listed(store, believed=SIGNED.verification_keys)) == ["old"]
    assert remove(store, "old", SIGNED).removed
    assert listed(store, believed=SIGNED.verification_keys)["old"].removed


def test_a_mistyped_collection_is_not_made() -> None:
    store = MemoryStore()
    publish(bundle(), store, key="a")
    with pytest.raises(FileNotFoundError, match="defualt"):
        rebuild(store, "defualt")
    assert [head.name for head in store.list("collections/defualt/")] == []


def test_retired_shards_stay_a_while_and_go(monkeypatch: pytest.MonkeyPatch) -> None:
    store = MemoryStore()
    seen: list[str] = []
    for number in range(3 * retired.RETIRED_INLINE):
        publish(bundle(content=str(number)), store, key="a", policy=SIGNING)
        seen += [shard.name for shard in index_of(store).parts]
    there = [head.name for head in list_all(store, "collections/default/shard.")]
    assert sorted(there) == sorted(seen), "for readers that have read an older root"
    assert len(store.get(INDEX)) < 4_000
    monkeypatch.setattr(retired, "KEPT_S", -1.0)
    publish(bundle(content="last"), store, key="a", policy=SIGNING)
    there = [head.name for head in list_all(store, "collections/default/")]
    assert len([name for name in there if "shard." in name]) <= retired.RETIRED_INLINE + 1
    assert not [name for name in there if "retired." in name]


def test_rivals_lose_nothing_and_leave_nothing(store: Store) -> None:
    """Publishers of other keys, of the same key, and one who removes, all at once."""
    publish(bundle(), store, key="gone", policy=SIGNING)

    def one(number: int) -> None:
        if number == 5:
            remove(store, "gone", SIGNED)
        else:
            publish(bundle(content=str(number)), store, key=f"k{number % 8}", job=f"job_{number}", policy=SIGNING)

    with ThreadPoolExecutor(6) as pool:
        list(pool.map(one, range(12)))
    found = listed(store, believed=SIGNED.verification_keys)
    assert {key: row.version for key, row in found.items()} == {
        **{f"k{number}": 2 if number < 4 else 1 for number in range(8) if number != 5},
        "gone": 1,
    }
    assert found["gone"].removed
    assert all(row == row_of(read_entry(store, key)) for key, row in found.items())
    index = index_of(store)
    known = {*(shard.name for shard in index.parts), *index.retired}
    assert {head.name for head in list_all(store, "collections/default/shard.")} == known
    assert not store.list("collections/default/waiting/")


def test_a_slow_publisher_does_not_take_its_row_back() -> None:
    """One stops between its entry and its collection; meanwhile another publishes the next version of the key."""
    store = MemoryStore()
    reached, go_on = threading.Event(), threading.Event()

    class Slow(CrashingStore):
        def put(self, name: str, data: bytes | Path, **how: object) -> object:  # type: ignore[override]
            if "shard" in name:
                reached.set()
                assert go_on.wait(10)
            return super().put(name, data, **how)  # type: ignore[arg-type]

    with ThreadPoolExecutor(1) as pool:
        slow = pool.submit(publish, bundle(content="1"), Slow(store, -1, after=False), key="a", job="job_1")
        assert reached.wait(10)
        publish(bundle(content="2"), store, key="a", job="job_2")
        go_on.set()
        slow.result()
    assert listed(store)["a"].version == 2
    index = index_of(store, Keys())
    there = {head.name for head in store.list("collections/default/shard.")}
    assert there == {*(shard.name for shard in index.parts), *index.retired}


class Interrupted(CrashingStore):
    """A store at which a rival acts once, around the n-th reading of an object: before it, or just after."""

    def __init__(self, inner: Store, prefix: str, nth: int, rival: Callable[[], object], *, after: bool) -> None:
        super().__init__(inner, -1, after=False)
        self._awaited, self._reads, self._act, self._behind = prefix, nth, rival, after

    def get(self, name: str, *, start: int = 0, length: int | None = None) -> bytes:
        self._reads -= name.startswith(self._awaited)
        act = self._reads == 0 and name.startswith(self._awaited)
        if act and not self._behind:
            self._act()
        data = super().get(name, start=start, length=length)
        if act and self._behind:
            self._act()
        return data


@pytest.mark.parametrize("nth", [1, 2])
def test_a_row_is_never_that_of_an_older_entry(nth: int) -> None:
    """Just after the entry was read, a rival publishes the next version and lists it."""
    store = MemoryStore()
    publish(bundle(content="1"), store, key="a")
    for name in (INDEX, index_name("default")):
        store.delete(name)
    rival = partial(publish, bundle(content="2"), store, key="a")
    update_collections(Interrupted(store, entry_name("a"), nth, rival, after=True), "a")
    assert listed(store)["a"].version == 2


def test_a_shard_that_went_meanwhile_is_no_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(retired, "RETIRED_INLINE", 0)
    monkeypatch.setattr(retired, "KEPT_S", -1.0)
    store = MemoryStore()
    publish(bundle(), store, key="a")
    slow = Interrupted(store, "collections/default/shard.", 1, partial(publish, bundle(), store, key="b"), after=False)
    publish(bundle(), slow, key="c")
    assert list(listed(store)) == ["a", "b", "c"]


def _publish_keys(store: Store, process: int) -> None:
    for number in range(3):
        publish(bundle(content="x"), store, key=f"k{process}{number}", policy=SIGNING)


def _publish_local(root: Path, process: int) -> None:
    _publish_keys(LocalStore(root), process)


def _publish_s3(server: S3Server, bucket: str, process: int) -> None:
    _publish_keys(s3_store(server, bucket), process)


@pytest.mark.slow
def test_rival_processes_share_a_collection(tmp_path: Path) -> None:
    _in_processes(_publish_local, tmp_path)
    store = LocalStore(tmp_path)
    assert len(listed(store, believed=SIGNED.verification_keys)) == index_of(store).version == 6


@pytest.mark.s3
def test_rival_processes_share_a_collection_on_s3(s3_server: S3Server) -> None:
    store = s3_store(s3_server, "rival-collections")
    _in_processes(_publish_s3, s3_server, "rival-collections")
    assert len(listed(store, believed=SIGNED.verification_keys)) == index_of(store).version == 6
