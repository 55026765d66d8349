"""verify(): every hash from the index to the last file, and a name for whatever does not hold."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from capture2vr.storage.catalogue.change_entry import remove
from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.catalogue.faults import (
    CATALOGUE_MISSING,
    CATALOGUE_OLDER,
    FILE_CHANGED,
    FILE_MISSING,
    KEY_UNKNOWN,
    MANIFEST_CHANGED,
    MANIFEST_MISSING,
    SHARD_CHANGED,
    SHARD_MISSING,
    SIGNATURE_WRONG,
)
from capture2vr.storage.catalogue.publish import PublishPolicy, publish
from capture2vr.storage.catalogue.reader import read_root
from capture2vr.storage.catalogue.root import root_name
from capture2vr.storage.catalogue.signing import Keys, PublicKey
from capture2vr.storage.catalogue.verify import CheckResult, fetch_from, verify
from capture2vr.storage.memory import MemoryStore
from capture2vr.storage.store import Store
from tests.storage.catalogue.test_signing import ONE, TWO
from tests.support.bundles import bundle, listed

ROOT = root_name("default")


@pytest.fixture
def whole() -> MemoryStore:
    """Two assets, one of them removed, signed by ONE."""
    store = MemoryStore()
    for key in ("chair", "dress"):
        publish(bundle(content=key), store, key=key, policy=PublishPolicy(Keys(signers=(ONE,))))
    remove(store, "chair", Keys(signers=(ONE,)))
    return store


def checked(store: Store, *believed: PublicKey, at_least: int = 0) -> list[CheckResult]:
    return list(verify(fetch_from(store), "default", believed or (ONE.public,), at_least=at_least))


def test_a_whole_collection_is_counted_to_the_last_byte(whole: MemoryStore) -> None:
    lines = checked(whole, at_least=3)
    assert [(line.kind, line.count, line.faults) for line in lines] == [
        ("root", 1, ()),
        ("shards", 1, ()),
        ("manifests", 2, ()),
        ("files", 8, ()),
    ]
    assert lines[0].summary.startswith("version 3, ")
    files = [file for key in ("chair", "dress") for file in read_entry(whole, key).document["files"]]
    assert lines[3].bytes == sum(file["bytes"] for file in files)


def test_files_larger_than_a_block_are_read_to_their_end(whole: MemoryStore, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("capture2vr.storage.catalogue.verify._BLOCK_BYTES", 5)
    assert not any(line.faults for line in checked(whole))


def _lod(store: Store) -> str:
    return str(read_entry(store, "dress").document["lods"][1]["name"])


def _manifest(store: Store) -> str:
    return listed(store)["dress"].manifest_name


def _shard(store: Store) -> str:
    return read_root(store, "default").parts[0].name


@pytest.mark.parametrize(
    ("of", "what", "missing", "changed"),
    [
        (_lod, "files", FILE_MISSING, FILE_CHANGED),
        (_manifest, "manifests", MANIFEST_MISSING, MANIFEST_CHANGED),
        (_shard, "shards", SHARD_MISSING, SHARD_CHANGED),
    ],
)
def test_what_is_missing_or_changed_is_named(
    whole: MemoryStore, of: Callable[[Store], str], what: str, missing: str, changed: str
) -> None:
    name = of(whole)
    data = whole.get(name)
    for damaged in (data[:-1], data + b" ", data[:-1] + bytes([data[-1] ^ 1]), b""):
        whole.put(name, damaged, content_type="x/y")
        assert_only(checked(whole), what, changed, name)
    whole.delete(name)
    assert_only(checked(whole), what, missing, name)


def assert_only(lines: list[CheckResult], what: str, code: str, name: str) -> None:
    """One fault, in the last class that was looked at."""
    assert [line.kind for line in lines if line.faults] == [what] == [lines[-1].kind]
    assert [(fault.code, fault.name) for fault in lines[-1].faults] == [(code, name)]


def test_an_index_that_is_not_believed_ends_it(whole: MemoryStore) -> None:
    assert_only(checked(whole, TWO.public), "root", KEY_UNKNOWN, ROOT)
    assert_only(checked(whole, at_least=4), "root", CATALOGUE_OLDER, ROOT)
    whole.put(ROOT, whole.get(ROOT).replace(b"version", b"Version"), content_type="x/y")
    assert_only(checked(whole), "root", SIGNATURE_WRONG, ROOT)
    assert_only(checked(MemoryStore()), "root", CATALOGUE_MISSING, ROOT)


def test_another_assets_manifest_is_no_substitute(whole: MemoryStore) -> None:
    """Whole and well-named, but not the one that was signed."""
    rows = listed(whole)
    whole.put(rows["dress"].manifest_name, whole.get(rows["chair"].manifest_name), content_type="x/y")
    assert_only(checked(whole), "manifests", MANIFEST_CHANGED, rows["dress"].manifest_name)
