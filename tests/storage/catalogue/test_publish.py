"""Publishing: whole assets only, whatever crashes, races or repeats."""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import re
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

from capture2vr.storage.bundle import FilesOnDisk
from capture2vr.storage.catalogue import compare_and_swap
from capture2vr.storage.catalogue.entry import Entry, alias_name, list_keys, read_entry, valid_key
from capture2vr.storage.catalogue.job_versions import StaleFence
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.local import LocalStore
from capture2vr.storage.memory import MemoryStore
from capture2vr.storage.store import IMMUTABLE, NO_CACHE, Store, list_all
from tests.referees.s3.server import S3Server
from tests.storage.conftest import near_store, s3_store
from tests.support.bundles import Crash, CrashingStore, bundle, listed
from tests.support.patience import HANG_S

CONTENT = 4 + 1  # files, manifest
PUTS = CONTENT + 1 + 1 + 1 + 1  # catalogue entry, alias, the collection's shard, its index


def assert_whole(store: Store, present: Entry) -> None:
    """Everything that the entry refers to is there, byte for byte, and so is every earlier version."""
    for file in [*present.document["files"], *present.document["lods"], present.document["manifest"]]:
        content = store.get(file["name"])
        assert hashlib.sha256(content).hexdigest() == file["sha256"]
        assert len(content) == file["bytes"]
        assert file["sha256"] in file["name"]
    for version in present.versions:
        assert json.loads(store.get(version["manifest"]))["key"] == present.key


def alias(store: Store, key: str) -> dict[str, object]:
    return dict(json.loads(store.get(alias_name(key))))


def test_the_first_publication_is_version_one(store: Store) -> None:
    asset = publish(bundle(), store, key="dress", job="job_1")
    present = read_entry(store, "dress")
    assert (asset.key, asset.version, asset.state) == ("dress", 1, "preview")
    assert (present.version, present.state, present.manifest) == (1, "preview", asset.manifest)
    assert alias(store, "dress") == {"version": 1, "manifest": asset.manifest}
    assert present.document["label"] == "Dress"
    assert present.document["preview"]["file"] == "preview.png"
    assert_whole(store, present)


def test_refined_replaces_the_preview_under_the_same_key(store: Store) -> None:
    publish(bundle("preview"), store, key="dress", job="job_1")
    asset = publish(bundle("refined"), store, key="dress", job="job_1")
    present = read_entry(store, "dress")
    assert (asset.version, present.version, present.state) == (2, 2, "refined")
    assert [(each["version"], each["state"]) for each in present.versions] == [(1, "preview"), (2, "refined")]
    assert alias(store, "dress")["version"] == 2
    assert_whole(store, present)


def test_levels_come_finest_first_with_their_counts_and_places() -> None:
    store = MemoryStore()
    publish(bundle(), store, key="dress")
    levels = read_entry(store, "dress").document["lods"]
    assert [(each["level"], each["triangles"], each["vertices"]) for each in levels] == [(0, 100, 60), (1, 50, 30)]
    assert all(store.head(each["name"]).size == each["bytes"] for each in levels)


def test_private_files_are_not_published(store: Store) -> None:
    """They show the photos of whoever sent them."""
    photographed = replace(bundle(), private={"photo-1.jpg": b"somebody's living room"})
    publish(photographed, store, key="dress")
    objects = [head.name for head in list_all(store, "")]
    assert not [name for name in objects if "photo" in name]
    assert not [name for name in objects if b"living room" in store.get(name) or b"photo-1" in store.get(name)]
    assert_whole(store, read_entry(store, "dress"))


def test_files_on_disk_are_published_like_those_in_memory(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"a tile")
    store, small = MemoryStore(), bundle()
    files = FilesOnDisk(small.files, {"tile-0-0-0-0.glb": tmp_path / "a"})
    assert len(files) == len(list(files)) == len(small.files) + 1
    publish(replace(small, files=files), store, key="dress")
    stored = {each["file"]: store.get(each["name"]) for each in read_entry(store, "dress").document["files"]}
    assert stored == {**small.files, "tile-0-0-0-0.glb": b"a tile"}


def test_files_are_immutable_and_pointers_are_not(store: Store) -> None:
    publish(bundle(), store, key="dress")
    for found in list_all(store, ""):
        expected = IMMUTABLE if re.search(r"\.[0-9a-f]{64}\.", found.name) else NO_CACHE
        assert store.head(found.name).cache_control == expected
    lod = read_entry(store, "dress").document["lods"][0]
    assert store.head(lod["name"]).content_type == "model/gltf-binary"


@pytest.mark.parametrize("job", ["job_1", ""])
def test_publishing_twice_adds_nothing(store: Store, job: str) -> None:
    first = publish(bundle(), store, key="dress", job=job)
    before = {head.name: head.etag for head in list_all(store, "")}
    assert publish(bundle(), store, key="dress", job=job) == first
    assert {head.name: head.etag for head in list_all(store, "")} == before


def test_a_repeated_job_keeps_its_first_result() -> None:
    """A job that ran twice may come to other bytes; clients that hold version 1 must not see it change."""
    store = MemoryStore()
    first = publish(bundle(content="a"), store, key="dress", job="job_1")
    assert publish(bundle(content="b"), store, key="dress", job="job_1") == first
    assert len(read_entry(store, "dress").versions) == 1


def test_a_late_preview_does_not_hide_its_refined_version() -> None:
    store = MemoryStore()
    refined = publish(bundle("refined"), store, key="dress", job="job_1")
    assert publish(bundle("preview"), store, key="dress", job="job_1") == refined
    assert read_entry(store, "dress").state == "refined"


def test_the_last_preview_of_a_job_replaces_its_first() -> None:
    """A job without a training publishes its mesh at once, and once more with textures."""
    store = MemoryStore()
    first = publish(bundle(content="plain"), store, key="dress", job="job_1")
    textured = replace(bundle(content="textured"), last=True)
    last = publish(textured, store, key="dress", job="job_1")
    assert (first.version, last.version, last.state) == (1, 2, "preview")
    assert last.manifest == read_entry(store, "dress").manifest != first.manifest
    # The job runs once more, on another worker: nothing is added, and its first preview hides nothing.
    assert publish(bundle(content="plain again"), store, key="dress", job="job_1", fence=1) == last
    assert publish(replace(textured, files={}), store, key="dress", job="job_1", fence=1) == last
    assert len(read_entry(store, "dress").versions) == 2


def test_known_bytes_are_not_sent_again() -> None:
    store = MemoryStore()
    publish(bundle(), store, key="dress", job="job_1")
    again = CrashingStore(store, at=1, after=False)  # dies at the first put, which must be that of the manifest
    with pytest.raises(Crash, match="manifest"):
        publish(bundle(label="Other"), again, key="dress", job="job_2")


@pytest.mark.parametrize("after", [False, True], ids=["before", "after"])
@pytest.mark.parametrize("at", range(1, PUTS + 1))
@pytest.mark.parametrize("kind", ["memory", "local"])
def test_a_crash_at_any_put_leaves_a_whole_asset(kind: str, tmp_path: Path, at: int, after: bool) -> None:
    crash_and_run_again(near_store(kind, tmp_path), "dress", at, after=after)


@pytest.mark.s3
def test_a_crash_at_the_puts_that_matter_leaves_a_whole_asset_on_s3(s3_server: S3Server) -> None:
    store = s3_store(s3_server)
    for at in range(CONTENT, PUTS + 1):
        crash_and_run_again(store, f"dress-{at}", at, after=True)


def crash_and_run_again(store: Store, key: str, at: int, *, after: bool) -> None:
    """Whatever put the process dies at, a whole asset is there, and the next run completes the new one."""
    publish(bundle(content="old"), store, key=key, job="job_1")
    with pytest.raises(Crash):
        publish(bundle(content="new"), CrashingStore(store, at=at, after=after), key=key, job="job_2")

    present = read_entry(store, key)
    assert present.version in (1, 2)
    assert alias(store, key)["version"] in (1, present.version)
    assert_whole(store, present)
    assert listed(store)[key].version in (1, alias(store, key)["version"])

    asset = publish(bundle(content="new"), store, key=key, job="job_2")
    present = read_entry(store, key)
    assert (asset.version, present.version, len(present.versions)) == (2, 2, 2)
    assert alias(store, key) == {"version": 2, "manifest": asset.manifest}
    assert_whole(store, present)
    assert listed(store)[key].version == 2


def test_a_crash_at_the_very_first_publication_leaves_no_asset() -> None:
    for at in range(1, CONTENT + 1):
        store = MemoryStore()
        with pytest.raises(Crash):
            publish(bundle(), CrashingStore(store, at=at, after=True), key="dress", job="job_1")
        with pytest.raises(FileNotFoundError):
            read_entry(store, "dress")


def test_a_lower_fence_is_refused(store: Store) -> None:
    publish(bundle("preview"), store, key="dress", job="job_1", fence=2)
    with pytest.raises(StaleFence, match="this is fence 1"):
        publish(bundle("refined"), store, key="dress", job="job_1", fence=1)
    assert read_entry(store, "dress").version == 1


def test_a_repeat_under_a_higher_fence_shuts_the_lower_out() -> None:
    store = MemoryStore()
    first = publish(bundle("preview"), store, key="dress", job="job_1", fence=1)
    assert publish(bundle("preview"), store, key="dress", job="job_1", fence=2) == first
    with pytest.raises(StaleFence):
        publish(bundle("refined"), store, key="dress", job="job_1", fence=1)


def test_fences_of_other_jobs_do_not_count() -> None:
    store = MemoryStore()
    publish(bundle(content="a"), store, key="dress", job="job_1", fence=9)
    assert publish(bundle(content="b"), store, key="dress", job="job_2", fence=1).version == 2


def test_rival_publishers_lose_no_version(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compare_and_swap, "_RACE_S", HANG_S)  # on a crowded machine each round takes seconds

    def one(number: int) -> int:
        return publish(bundle(content=str(number)), store, key="dress", job=f"job_{number}").version

    with ThreadPoolExecutor(6) as pool:
        versions = sorted(pool.map(one, range(12)))
    assert versions == list(range(1, 13))
    present = read_entry(store, "dress")
    assert {each["job"] for each in present.versions} == {f"job_{number}" for number in range(12)}
    assert alias(store, "dress") == {"version": 12, "manifest": present.manifest}
    assert_whole(store, present)


def _publish_some(store: Store, process: int) -> None:
    for number in range(3):
        publish(bundle(content=f"{process} {number}"), store, key="dress", job=f"job_{process}_{number}")


def _publish_local(root: Path, process: int) -> None:
    _publish_some(LocalStore(root), process)


def _publish_s3(server: S3Server, bucket: str, process: int) -> None:
    _publish_some(s3_store(server, bucket), process)


def _in_processes(target: object, *arguments: object) -> None:
    context = multiprocessing.get_context("spawn")
    processes = [context.Process(target=target, args=(*arguments, number)) for number in range(2)]  # type: ignore[arg-type]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    assert [process.exitcode for process in processes] == [0, 0]


@pytest.mark.slow
def test_rival_processes_share_a_local_root(tmp_path: Path) -> None:
    _in_processes(_publish_local, tmp_path)
    present = read_entry(LocalStore(tmp_path), "dress")
    assert sorted(each["version"] for each in present.versions) == list(range(1, 7))
    assert len({each["job"] for each in present.versions}) == 6


@pytest.mark.s3
def test_rival_processes_share_a_bucket(s3_server: S3Server) -> None:
    s3_store(s3_server, "rivals")
    _in_processes(_publish_s3, s3_server, "rivals")
    present = read_entry(s3_store(s3_server, "rivals"), "dress")
    assert sorted(each["version"] for each in present.versions) == list(range(1, 7))
    assert len({each["job"] for each in present.versions}) == 6


@pytest.mark.parametrize("key", ["a", "0", "dress", "Dress-2.blue_x", "x" * 100])
def test_valid_keys(key: str) -> None:
    assert valid_key(key)


@pytest.mark.parametrize("key", ["", ".a", "-a", "a/b", "a b", "ä", "x" * 101, "a\n", "../a"])
def test_invalid_keys_are_refused_everywhere(key: str) -> None:
    store = MemoryStore()
    assert not valid_key(key)
    with pytest.raises(ValueError, match="not a valid asset key"):
        publish(bundle(), store, key=key)
    with pytest.raises(ValueError, match="not a valid asset key"):
        read_entry(store, key)


def test_keys_are_listed_in_pages(store: Store) -> None:
    for key in ("c", "a", "b"):
        publish(bundle(), store, key=key)
    assert list_keys(store) == ["a", "b", "c"]
    assert list_keys(store, limit=2) == ["a", "b"]
    assert list_keys(store, after="b") == ["c"]
