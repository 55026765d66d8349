"""What a folder must survive: power cuts between two renames, killed processes, restored backups."""

from __future__ import annotations

import errno
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.storage.bundle import sha256_hex
from capture2vr.storage.local import LocalStore
from capture2vr.storage.store import NO_CACHE

TEXT = "text/plain"


@pytest.fixture
def store(tmp_path: Path) -> LocalStore:
    return LocalStore(tmp_path / "objects")


def test_the_object_is_a_plain_file(store: LocalStore) -> None:
    store.put("assets/a/b.txt", b"1", content_type=TEXT)
    assert (store.root / "assets" / "a" / "b.txt").read_bytes() == b"1"


def test_a_crash_between_the_renames_shows_the_old_bytes_under_their_own_etag(store: LocalStore) -> None:
    first = store.put("a", b"old", content_type=TEXT)
    (store.root / "a").rename(store.root.parent / "old")
    shutil.copy(store.root / ".meta" / "a", store.root.parent / "meta")
    store.put("a", b"new", content_type="text/html")
    (store.root.parent / "old").replace(store.root / "a")  # the new sidecar beside the old bytes
    assert store.get("a") == b"old"
    assert store.head("a").etag == first.etag


@pytest.mark.parametrize("sidecar", [None, b"", b"{}", b"\0\0\0"])
def test_a_lost_sidecar_is_renewed(store: LocalStore, sidecar: bytes | None) -> None:
    store.put("assets/a/lod0.glb", b"glTF", content_type="model/gltf-binary")
    meta = store.root / ".meta" / "assets" / "a" / "lod0.glb"
    if sidecar is None:
        meta.unlink()
    else:
        meta.write_bytes(sidecar)
    head = store.head("assets/a/lod0.glb")
    assert (head.etag, head.content_type, head.cache_control) == (sha256_hex(b"glTF"), "model/gltf-binary", NO_CACHE)
    assert meta.stat().st_size > len(sidecar or b"")


def test_a_restored_backup_has_the_same_etags(store: LocalStore, tmp_path: Path) -> None:
    put = store.put("assets/a/b.txt", b"1", content_type="text/x-own")
    shutil.copytree(store.root, tmp_path / "restored")
    head = LocalStore(tmp_path / "restored").head("assets/a/b.txt")
    assert (head.etag, head.content_type) == (put.etag, "text/x-own")


def test_what_a_dead_process_left_is_removed_when_it_is_old(store: LocalStore) -> None:
    old, young = store.root / ".tmp" / "old", store.root / ".tmp" / "young"
    for file in (old, young):
        file.write_bytes(b"half")
    os.utime(old, (time.time() - 100_000,) * 2)
    LocalStore(store.root)
    assert [file.name for file in (store.root / ".tmp").iterdir()] == ["young"]


def test_a_file_is_linked_where_that_is_allowed_and_its_disk_can(
    store: LocalStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = tmp_path / "in"
    source.write_bytes(b"1")
    for name, link in (("copied", False), ("linked", True), ("linked", True)):
        store.put(name, source, content_type=TEXT, link=link)
        assert store.path(name).samefile(source) is link

    def other_disk(*_: object) -> None:
        raise OSError(errno.EXDEV, "Invalid cross-device link")

    monkeypatch.setattr(Path, "hardlink_to", other_disk)
    store.put("linked", source, content_type=TEXT, link=True)
    assert not store.path("linked").samefile(source)
    assert store.get("linked") == b"1"
    assert list((store.root / ".tmp").iterdir()) == []


NAMES = st.lists(st.sampled_from(["a", "b", "a-b", "a.b", "ab", "A", "0", "b0"]), min_size=1, max_size=3).map("/".join)


def _placed(root: Path, names: set[str]) -> list[str]:
    """Write these names' files, but for those whose folder is a file already; sorted."""
    placed = []
    for name in sorted(names):
        if not any(f"{each}/" == name[: len(each) + 1] for each in placed):
            (root / name).parent.mkdir(parents=True, exist_ok=True)
            (root / name).write_bytes(b"1")
            placed.append(name)
    return placed


@given(
    names=st.sets(NAMES),
    prefix=st.one_of(st.just(""), NAMES, NAMES.map("{}/".format)),
    after=st.one_of(st.just(""), NAMES),
)
def test_a_listing_is_the_sorted_names_with_the_prefix_behind_the_last(
    names: set[str], prefix: str, after: str
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        store = LocalStore(Path(folder))
        placed = _placed(store.root, names)
        expected = [name for name in placed if name.startswith(prefix) and name > after]
        assert [head.name for head in store.list(prefix, after=after)] == expected
        assert [head.name for head in store.list(prefix, after=after, limit=2)] == expected[:2]


def test_a_page_reads_only_the_folders_it_needs(store: LocalStore, monkeypatch: pytest.MonkeyPatch) -> None:
    for number in range(50):
        store.put(f"tenants/t{number:02}/a/1", b"1", content_type=TEXT)
    read: list[str] = []
    scandir = os.scandir
    monkeypatch.setattr(os, "scandir", lambda folder: read.append(str(folder)) or scandir(folder))
    assert [head.name for head in store.list("", after="tenants/t30/a/0", limit=2)] == [
        "tenants/t30/a/1",
        "tenants/t31/a/1",
    ]
    assert len(read) == 6  # the root, tenants, and two of each tenant


@pytest.mark.parametrize("link", [False, True])
def test_a_failed_put_leaves_nothing(store: LocalStore, tmp_path: Path, link: bool) -> None:
    with pytest.raises(FileNotFoundError):
        store.put("a", tmp_path / "absent", content_type=TEXT, link=link)
    assert list((store.root / ".tmp").iterdir()) == []
    assert store.list("") == []


WRITER = """
import sys
from pathlib import Path
from capture2vr.storage.local import LocalStore
store = LocalStore(Path(sys.argv[1]))
number = 0
while True:
    number += 1
    store.put("a", str(number % 10).encode() * 200_000, content_type="text/plain")
    store.put(f"many/{number}", b"x" * 1000, content_type="text/plain")
    print(number, flush=True)
"""


@pytest.mark.parametrize("seed", range(3))
def test_kill_9_leaves_whole_objects_and_loses_none_that_was_acknowledged(store: LocalStore, seed: int) -> None:
    process = subprocess.Popen((sys.executable, "-c", WRITER, str(store.root)), stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    process.stdout.readline()
    time.sleep(random.Random(seed).uniform(0.05, 0.3))
    process.send_signal(signal.SIGKILL)
    acknowledged = 1 + len(process.communicate()[0].splitlines())
    content = store.get("a")
    assert content == content[:1] * 200_000
    assert store.head("a").etag == sha256_hex(content)
    assert {f"many/{number}" for number in range(1, acknowledged + 1)} <= {head.name for head in store.list("many/")}
    store.put("a", b"again", content_type=TEXT, if_match=store.head("a").etag)
