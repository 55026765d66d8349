"""What every store promises."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from capture2vr.storage.s3 import S3Store
from capture2vr.storage.store import IMMUTABLE, LAST, NO_CACHE, ConditionFailed, Store, list_all

TEXT = "text/plain"


def test_put_then_get_gives_the_same_bytes(store: Store) -> None:
    content = bytes(range(256)) * 100
    store.put("assets/a/b.bin", content, content_type="application/octet-stream")
    assert store.get("assets/a/b.bin") == content


@pytest.mark.parametrize(
    ("start", "length"), [(0, None), (0, 3), (3, 4), (8, None), (8, 100), (10, None), (50, 2), (4, 0)]
)
def test_a_range_is_a_slice(store: Store, start: int, length: int | None) -> None:
    content = b"0123456789"
    store.put("r", content, content_type=TEXT)
    end = None if length is None else start + length
    assert store.get("r", start=start, length=length) == content[start:end]


def test_an_empty_object_is_an_object(store: Store) -> None:
    store.put("empty", b"", content_type=TEXT)
    assert store.get("empty") == b""
    assert store.head("empty").size == 0


def test_head_tells_what_put_said(store: Store) -> None:
    put = store.put("a/b.txt", b"hello", content_type=TEXT, cache_control=NO_CACHE)
    head = store.head("a/b.txt")
    assert (head.name, head.size, head.content_type, head.cache_control) == ("a/b.txt", 5, TEXT, NO_CACHE)
    assert head.etag == put.etag
    assert '"' not in head.etag
    assert abs(head.modified - datetime.now(UTC)) < timedelta(minutes=5)


def test_objects_are_immutable_to_caches_unless_told_otherwise(store: Store) -> None:
    store.put("a", b"1", content_type=TEXT)
    assert store.head("a").cache_control == IMMUTABLE


def test_a_second_put_replaces_all_of_the_first(store: Store) -> None:
    first = store.put("a", b"a long content", content_type=TEXT)
    second = store.put("a", b"short", content_type="text/html", cache_control=NO_CACHE)
    assert store.get("a") == b"short"
    assert first.etag != second.etag
    assert (store.head("a").content_type, store.head("a").cache_control) == ("text/html", NO_CACHE)


def test_a_file_goes_in_and_comes_out(store: Store, tmp_path: Path) -> None:
    source, target = tmp_path / "in", tmp_path / "out"
    source.write_bytes(b"x" * 3_000_001)
    head = store.put("captures/c.zip", source, content_type="application/zip")
    store.fetch("captures/c.zip", target)
    assert head.size == 3_000_001
    assert target.read_bytes() == source.read_bytes()


def test_a_file_that_may_be_linked_can_be_deleted(store: Store, tmp_path: Path) -> None:
    source = tmp_path / "in"
    source.write_bytes(b"1" * 1_000)
    store.put("a", b"before", content_type=TEXT)
    linked = store.put("a", source, content_type=TEXT, link=True)
    copied = store.put("b", source, content_type=TEXT)
    source.unlink()
    assert store.get("a") == b"1" * 1_000
    assert store.head("a").etag == linked.etag == copied.etag


def test_a_big_file_goes_in_parts(store: Store, tmp_path: Path) -> None:
    source, target = tmp_path / "in", tmp_path / "out"
    source.write_bytes(bytes(range(256)) * (33 * 4096) + b"tail")  # 33 MiB and a bit: three parts on S3
    head = store.put("captures/big.zip", source, content_type="application/zip")
    store.fetch("captures/big.zip", target)
    assert target.read_bytes() == source.read_bytes()
    assert store.get("captures/big.zip", start=head.size - 4) == b"tail"
    assert store.head("captures/big.zip").content_type == "application/zip"


def test_absent_is_file_not_found(store: Store, tmp_path: Path) -> None:
    for read in (store.get, store.head, lambda name: store.get(name, length=0), lambda name: store.get(name, start=3)):
        with pytest.raises(FileNotFoundError):
            read("no/such")
    with pytest.raises(FileNotFoundError):
        store.fetch("no/such", tmp_path / "target")
    assert list(tmp_path.glob("*target*")) == []


def test_a_folder_is_no_object(store: Store) -> None:
    store.put("a/b/c", b"1", content_type=TEXT)
    for name in ("a", "a/b", "a/b/c/d"):
        with pytest.raises(FileNotFoundError):
            store.get(name)


def test_delete_is_idempotent(store: Store) -> None:
    store.put("a", b"1", content_type=TEXT)
    store.delete("a")
    store.delete("a")
    with pytest.raises(FileNotFoundError):
        store.head("a")


IMPOSSIBLE = (
    "",
    "/",
    "/etc/passwd",
    "../x",
    "a/../b",
    "a/./b",
    "a//b",
    "a/",
    "C:/x",
    "a\\b",
    ".meta/a",
    "a/.hidden",
    "a b",
)
IMPOSSIBLE += ("a\0b", "a\n", "é", "x" * 600)


@pytest.mark.parametrize("name", IMPOSSIBLE)
def test_an_impossible_name_is_a_value_error(store: Store, name: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="not a valid object name"):
        store.put(name, b"1", content_type=TEXT)
    for read in (store.get, store.head, store.delete, store.url):
        with pytest.raises(ValueError, match="not a valid object name"):
            read(name)
    with pytest.raises(ValueError, match="not a valid object name"):
        store.fetch(name, tmp_path / "x")


def test_if_absent_lets_only_the_first_in(store: Store) -> None:
    store.put("claim", b"first", content_type=TEXT, if_absent=True)
    with pytest.raises(ConditionFailed):
        store.put("claim", b"second", content_type=TEXT, if_absent=True)
    assert store.get("claim") == b"first"


def test_if_match_replaces_only_what_was_read(store: Store) -> None:
    first = store.put("a", b"1", content_type=TEXT)
    second = store.put("a", b"2", content_type=TEXT, if_match=first.etag)
    with pytest.raises(ConditionFailed):
        store.put("a", b"3", content_type=TEXT, if_match=first.etag)
    assert store.get("a") == b"2"
    store.put("a", b"3", content_type=TEXT, if_match=second.etag)
    assert store.get("a") == b"3"


def test_if_match_of_an_absent_object_fails(store: Store) -> None:
    with pytest.raises(ConditionFailed):
        store.put("a", b"1", content_type=TEXT, if_match="0123")
    with pytest.raises(FileNotFoundError):
        store.head("a")


def test_a_conditional_put_takes_a_file_too(store: Store, tmp_path: Path) -> None:
    source = tmp_path / "in"
    source.write_bytes(b"x" * 100)
    store.put("claim", source, content_type=TEXT, if_absent=True)
    with pytest.raises(ConditionFailed):
        store.put("claim", source, content_type=TEXT, if_absent=True)


def test_one_of_many_rivals_wins_a_claim(store: Store) -> None:
    def claim(number: int) -> bool:
        barrier.wait()
        try:
            store.put("claim", str(number).encode(), content_type=TEXT, if_absent=True)
        except ConditionFailed:
            return False
        return True

    barrier = threading.Barrier(8)
    with ThreadPoolExecutor(8) as pool:
        wins = list(pool.map(claim, range(8)))
    assert sum(wins) == 1
    assert store.get("claim") == str(wins.index(True)).encode()


def test_read_and_replace_loses_no_update(store: Store) -> None:
    def add(number: int) -> None:
        while True:
            etag = store.head("set").etag
            content = store.get("set")
            try:
                store.put("set", content + f"{number},".encode(), content_type=TEXT, if_match=etag)
            except ConditionFailed:
                continue
            return

    store.put("set", b"", content_type=TEXT)
    with ThreadPoolExecutor(6) as pool:
        list(pool.map(add, range(12)))
    assert sorted(store.get("set").decode().split(",")[:-1], key=int) == [str(number) for number in range(12)]


def test_listing_is_in_order_and_in_pages(store: Store) -> None:
    """On S3 in one of two: that of whole names, or that of the names of folders and of what is in them."""
    names = sorted(["a/1", "a/10", "a/2", "a-b", "a.c", "a/B", "a/b/c", "a/b-c", "ab", "b/1"])
    for name in names:
        store.put(name, name.encode(), content_type=TEXT)
    listed = [head.name for head in store.list("")]
    assert listed == names or (isinstance(store, S3Store) and listed == sorted(names, key=lambda name: name.split("/")))
    assert [head.name for head in store.list("a/")] == [name for name in listed if name.startswith("a/")]
    assert [head.name for head in store.list("a")] == [name for name in listed if name.startswith("a")]
    paged: list[str] = []
    while page := store.list("a", after=paged[-1] if paged else "", limit=3):
        assert len(page) <= 3
        paged += [head.name for head in page]
    assert paged == [name for name in listed if name.startswith("a")]


def test_a_listing_skips_a_folder(store: Store) -> None:
    for name in ("a/x/1", "a/x/y/2", "a/x/z", "a/x-y/3", "a/x0/4", "a/x.z/5"):
        store.put(name, b"1", content_type=TEXT)
    assert {head.name for head in store.list("a/", after=f"a/x{LAST}")} | {"a/x-y/3", "a/x.z/5"} == {
        *("a/x-y/3", "a/x.z/5", "a/x0/4")
    }


def test_a_listing_goes_on_where_objects_were_deleted(store: Store) -> None:
    """A whole folder may be gone that the last object listed was in."""
    names = [f"a/{folder}/{file}" for folder in ("v1", "v1-b", "v2/c", "v3") for file in ("1", "2", "3")]
    for name in names:
        store.put(name, b"1", content_type=TEXT)
    for head in list_all(store, "a/", page=2):
        store.delete(head.name)
        names.remove(head.name)
    assert names == []


def test_listing_tells_size_and_etag(store: Store) -> None:
    put = store.put("a/b", b"123", content_type=TEXT)
    (listed,) = store.list("a/")
    assert (listed.name, listed.size, listed.etag, listed.content_type) == ("a/b", 3, put.etag, "")


def test_listing_nothing_is_empty(store: Store) -> None:
    assert store.list("") == []
    assert store.list("no/such/") == []
    assert store.list("../") == []
    assert store.list("", limit=0) == []


def test_list_all_walks_every_page(store: Store) -> None:
    names = [f"many/{number:02d}" for number in range(23)]
    for name in names:
        store.put(name, b"", content_type=TEXT)
    assert [head.name for head in list_all(store, "many/", page=5)] == names


def test_url_ends_with_the_name(store: Store) -> None:
    assert store.url("assets/a/lod0.glb").endswith("/assets/a/lod0.glb")
